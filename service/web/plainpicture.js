// A picture without what is not its own: the turn and the places that cameras note, and pictures behind its end.
"use strict";

const PNG = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];

/** Parts of a PNG in which programs note where, when and by whom it was made: EXIF, XMP, IPTC. */
const NOTES = ["eXIf", "iTXt", "tEXt", "zTXt", "tIME"];

/** The bytes (Uint8Array) of a PNG or JPEG file, plain; of anything else as they are. */
export function plainPicture(bytes) {
  const isPng = PNG.every((byte, at) => bytes[at] === byte);
  const kept = isPng ? partsOfPng(bytes) : bytes[0] === 0xff && bytes[1] === 0xd8 ? partsOfJpeg(bytes) : [bytes];
  return new Blob(kept, { type: isPng ? "image/png" : "image/jpeg" });
}

function partsOfPng(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const kept = [bytes.subarray(0, PNG.length)];
  for (let at = PNG.length; at + 12 <= bytes.length; ) {
    const end = at + 12 + view.getUint32(at);
    const kind = String.fromCharCode(...bytes.subarray(at + 4, at + 8));
    if (!NOTES.includes(kind)) kept.push(bytes.subarray(at, end));
    if (kind === "IEND") break;
    at = end;
  }
  return kept;
}

function partsOfJpeg(bytes) {
  const kept = [bytes.subarray(0, 2)];
  for (let at = 2; at + 2 <= bytes.length && bytes[at] === 0xff; ) {
    // Bytes that fill before a marker.
    if (bytes[at + 1] === 0xff) {
      at += 1;
      continue;
    }
    const marker = bytes[at + 1];
    if (marker === 0xd9) return [...kept, bytes.subarray(at, at + 2)];
    let end = at + 2 + 256 * bytes[at + 2] + bytes[at + 3];
    if (marker === 0xda) end = endOfScan(bytes, end);
    if (!isNoted(marker, bytes, at + 4)) kept.push(bytes.subarray(at, end));
    at = end;
  }
  return [bytes];
}

/** The next marker behind coded data: neither a stuffed byte nor a restart. */
function endOfScan(bytes, at) {
  for (let next = bytes.indexOf(0xff, at); next >= 0; next = bytes.indexOf(0xff, next + 1)) {
    const marker = bytes[next + 1];
    if (marker !== 0 && marker !== 0xff && (marker < 0xd0 || marker > 0xd7)) return next;
  }
  return bytes.length;
}

/** Whether a segment is a note (EXIF, XMP, IPTC, a comment: all but JFIF, colours and Adobe's), or lists pictures behind the end. */
function isNoted(marker, bytes, at) {
  const isApplication = marker >= 0xe0 && marker <= 0xef;
  return marker === 0xfe || (isApplication && ![0xe0, 0xe2, 0xee].includes(marker)) || (marker === 0xe2 && String.fromCharCode(...bytes.subarray(at, at + 3)) === "MPF");
}
