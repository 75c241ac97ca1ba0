// How coarsely a moving map has to be drawn, by how long it waits for its frames.

// Milliseconds: a mean above the first is too slow, one below the second leaves room.
const TOO_SLOW = 45, FAST = 20;
// Frames that are averaged before the map is drawn more coarsely, or finer.
const TO_COARSER = 2, TO_FINER = 30;

export class Pace {
  constructor(coarsest) {
    this.coarsest = coarsest;
    // At first as a graphics card can.
    this.level = 0;
    this._restart();
  }

  /** Take note of how long a frame was waited for. */
  count(milliseconds) {
    this.sum += milliseconds;
    this.frames++;
    const mean = this.sum / this.frames;
    if (this.frames >= TO_COARSER && mean > TOO_SLOW) this._go(1);
    else if (this.frames >= TO_FINER) this._go(mean < FAST ? -1 : 0);
  }

  _go(by) {
    this.level = Math.min(Math.max(this.level + by, 0), this.coarsest);
    this._restart();
  }

  _restart() {
    this.sum = 0;
    this.frames = 0;
  }
}
