"""The SDF decoder (paper III-B 2, Eq. 2-5): K neural points around a query -> signed distance in metres.

The blended local coordinate along the normals is the distance to the tangent planes; the shallow MLP adds what the
planes miss (decision 0115). One decoder is shared by every map, which lets maps of different sessions be merged.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import DataLoss
from revisit.core.kernels.neighbour_blend import ENCODING_SIZE

Array = NDArray[np.float32]


@dataclass(frozen=True)
class DecoderWeights:
    """MLP of `len(matrices) - 1` hidden layers: matrices[i] (out, in) float32 and biases[i] (out,) float32."""

    matrices: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]

    @property
    def feature_size(self) -> int:
        """F, the number of latent features of a neural point."""
        return int(self.matrices[0].shape[1]) - ENCODING_SIZE

    @property
    def digest(self) -> str:
        """First 16 hex digits of the SHA-256 of the weights: a map is decoded only by the decoder it was fitted to."""
        hasher = hashlib.sha256()
        for array in (*self.matrices, *self.biases):
            hasher.update(np.ascontiguousarray(array, dtype="<f4").tobytes())
        return hasher.hexdigest()[:16]

    def to_arrays(self) -> dict[str, NDArray[np.float32]]:
        """Named arrays for a weights file."""
        named = {f"decoder_matrix_{i}": m for i, m in enumerate(self.matrices)}
        return named | {f"decoder_bias_{i}": b for i, b in enumerate(self.biases)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[np.float32]]) -> DecoderWeights:
        """The weights in a file's named arrays."""
        layers = sum(name.startswith("decoder_matrix_") for name in arrays)
        return cls(
            tuple(arrays[f"decoder_matrix_{i}"] for i in range(layers)),
            tuple(arrays[f"decoder_bias_{i}"] for i in range(layers)),
        )

    def to_bytes(self) -> bytes:
        """All matrices, then all biases, as float32."""
        return b"".join(np.ascontiguousarray(a, dtype="<f4").tobytes() for a in (*self.matrices, *self.biases))

    @classmethod
    def from_bytes(cls, data: bytes, shapes: list[list[int]]) -> DecoderWeights:
        """The inverse of `to_bytes` for matrices of these `shapes`. Raises DataLoss where the sizes disagree."""
        try:
            sizes = [*(out * into for out, into in shapes), *(out for out, _ in shapes)]
        except (TypeError, ValueError) as error:
            raise DataLoss("the layers of the neural map's decoder are unreadable") from error
        values = np.frombuffer(data, "<f4")
        if sum(sizes) != len(values):
            raise DataLoss("the decoder of the neural map does not have the announced size")
        parts = np.split(values.copy(), np.cumsum(sizes)[:-1])
        matrices = tuple(part.reshape(shape) for part, shape in zip(parts, shapes, strict=False))
        return cls(matrices, tuple(parts[len(shapes) :]))


def decode(decoder: DecoderWeights, features: Array, encoding: Array, plane_distance: Array) -> Array:
    """Eq. 5: blended features (n, F), encoding (n, 9) and plane distance (n,) metres -> SDF (n,) metres."""
    hidden = np.concatenate([features, encoding], axis=1)
    for matrix, bias in zip(decoder.matrices[:-1], decoder.biases[:-1], strict=True):
        hidden = np.maximum(hidden @ matrix.T + bias, 0.0)
    correction = hidden @ decoder.matrices[-1].T + decoder.biases[-1]
    return np.asarray(plane_distance + correction[:, 0], dtype=np.float32)  # Eq. 5


def orientations(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rotations (n, 3, 3) into the local frames: rows are horizontal tangent, second tangent and the unit normal."""
    horizontal = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals), np.float32)], axis=1)
    length = np.linalg.norm(horizontal, axis=1, keepdims=True)
    tangent = np.where(length > 1e-3, horizontal / np.maximum(length, 1e-3), np.array([1.0, 0.0, 0.0], np.float32))
    tangent -= np.sum(tangent * normals, axis=1, keepdims=True) * normals
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.stack([tangent, np.cross(normals, tangent), normals], axis=1).astype(np.float32)


def encode_positions(local: NDArray[np.float32], resolution: float) -> NDArray[np.float32]:
    """gamma of Eq. 4: local coordinates (..., 3) metres -> (..., 9), linear and one sine-cosine band."""
    scaled = local / np.float32(resolution)
    angle = scaled * np.float32(np.pi / 2)
    return np.concatenate([scaled, np.sin(angle), np.cos(angle)], axis=-1)
