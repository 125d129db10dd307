// Live: the service's server-sent events, read through fetch since EventSource cannot send an API key.
"use strict";

import { KeyNeeded, headers } from "/api.js";

const PAUSE_MS = [500, 10_000];
const SILENT_MS = 45_000;

/** The events in a text of server-sent events that ends with a whole one; comments are left out. */
export function parsed(text) {
  return text
    .split("\n\n")
    .map((block) => Object.fromEntries(block.split("\n").filter((line) => line && !line.startsWith(":")).map((line) => {
      const colon = line.indexOf(": ");
      return [line.slice(0, colon), line.slice(colon + 2)];
    })))
    .filter((event) => event.data);
}

/**
 * A watch of a map. `onEvent` gets each event once and in order, through lost connections; `onState` hears "live" and
 * "lost". `stop` ends it. Behind `FORGOTTEN` the lists must be read again: `onForgotten`.
 */
export class Watch {
  constructor(map, { onEvent, onState, onForgotten }) {
    Object.assign(this, { map, onEvent, onState, onForgotten });
    this.after = null;
    this.stopped = false;
    this.opened = new Promise((resolve) => (this.markOpened = resolve));
    this.run();
  }

  stop() {
    this.stopped = true;
    this.connection?.abort();
  }

  async run() {
    for (let pause = PAUSE_MS[0]; !this.stopped; pause = Math.min(2 * pause, PAUSE_MS[1])) {
      try {
        await this.connect(() => (pause = PAUSE_MS[0]));
      } catch (error) {
        if (error instanceof KeyNeeded) this.stopped = true;
      }
      this.markOpened();
      if (this.stopped) return;
      this.onState("lost");
      await new Promise((resolve) => setTimeout(resolve, pause * (0.5 + Math.random())));
    }
  }

  async connect(works) {
    this.connection = new AbortController();
    const query = this.after === null ? "" : `?after=${this.after}`;
    const asked = { headers: headers("text/event-stream"), cache: "no-store", signal: this.connection.signal };
    const answer = await fetch(`/v1/${this.map}/events${query}`, asked);
    if (answer.status === 401) throw new KeyNeeded();
    if (answer.status === 403 || answer.status === 404) this.stopped = true;
    if (!answer.ok) throw new Error(`events: ${answer.status}`);
    works();
    this.onState("live");
    await this.readAll(answer.body.pipeThrough(new TextDecoderStream()).getReader());
  }

  async readAll(reader) {
    let rest = "";
    for (;;) {
      const silence = setTimeout(() => this.connection.abort(), SILENT_MS);
      const { done, value } = await reader.read().finally(() => clearTimeout(silence));
      if (done || this.stopped) return;
      const text = rest + value;
      const end = text.lastIndexOf("\n\n") + 2;
      rest = end > 1 ? text.slice(end) : text;
      if (end > 1) parsed(text.slice(0, end)).forEach((event) => this.take(event));
    }
  }

  take({ id, event, data }) {
    if (event === "problem") return;
    this.after = id;
    if (event === "opened") this.markOpened();
    else if (event === "forgotten") this.onForgotten();
    else this.onEvent(JSON.parse(data));
  }
}
