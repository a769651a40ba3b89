// The button that plays: it moves a time from beginning to end in so many seconds.

import { button } from "./controls.js";

export class Player {
  // `owner` has `time` and `end` (ms) and `moveTo(time)`; times begin at its `start`, or at 0.
  constructor(owner, seconds) {
    this.owner = owner;
    this.seconds = seconds;
    this.playing = false;
    this.button = button("▶", "play or pause", () => this.playOrPause());
  }

  playOrPause() {
    if (this.playing) return this.stop();
    const { owner } = this;
    const start = owner.start ?? 0;
    this.playing = true;
    this.button.textContent = "⏸";
    if (owner.time >= owner.end) owner.moveTo(start);
    let before = performance.now();
    const step = (now) => {
      if (!this.playing) return;
      const next = owner.time + ((now - before) / 1000 / this.seconds) * (owner.end - start);
      before = now;
      owner.moveTo(Math.min(next, owner.end));
      if (next >= owner.end) return this.stop();
      this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }

  stop() {
    this.playing = false;
    this.button.textContent = "▶";
    cancelAnimationFrame(this.frame);
  }
}
