/** What is shown now: the frame, whether it plays, whom the view follows, which camera is chosen. */

export type Change = "frame" | "playing" | "follow" | "camera" | "view";

export class Player {
  index = 0;
  playing = false;
  speed = 1;
  /** Index of the individual that is followed, -1 none. */
  follow = -1;
  /** Index of the camera that is looked through. */
  camera = 0;
  private clock = 0;
  private listeners: ((change: Change) => void)[] = [];

  /** When each frame is shown, in frames from the first: gaps between stretches take no time. */
  private readonly times: Float64Array;

  /** frames: numbers of the frames, in order; breaks: those that follow a gap; rate: frames a second. */
  constructor(readonly frames: Int32Array, breaks: ReadonlySet<number>, readonly rate: number) {
    this.times = new Float64Array(frames.length);
    for (let i = 1; i < frames.length; i++) {
      this.times[i] = this.times[i - 1]! + (breaks.has(i) ? 1 : frames[i]! - frames[i - 1]!);
    }
  }

  get last(): number {
    return this.frames.length - 1;
  }

  on(listener: (change: Change) => void): void {
    this.listeners.push(listener);
  }

  private tell(change: Change): void {
    for (const listener of this.listeners) listener(change);
  }

  seek(index: number): void {
    const to = Math.max(0, Math.min(this.last, Math.round(index)));
    if (to === this.index) return;
    this.index = to;
    this.tell("frame");
  }

  /** Go to the kept frame that is nearest to a frame number. */
  seekFrame(frame: number): void {
    let [low, high] = [0, this.last];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.frames[middle]! < frame) low = middle + 1;
      else high = middle;
    }
    const before = Math.max(0, low - 1);
    const nearer = frame - this.frames[before]! < this.frames[low]! - frame ? before : low;
    this.seek(nearer);
  }

  step(by: number): void {
    this.pause();
    this.seek(this.index + by);
  }

  toggle(): void {
    if (this.playing) return this.pause();
    if (this.index === this.last) this.seek(0);
    this.playing = this.last > 0;
    this.clock = performance.now();
    this.tell("playing");
    requestAnimationFrame((now) => this.tick(now));
  }

  pause(): void {
    if (!this.playing) return;
    this.playing = false;
    this.tell("playing");
  }

  choose(what: "follow" | "camera", value: number): void {
    if (this[what] === value) return;
    this[what] = value;
    this.tell(what);
  }

  /** Say that what is shown has to be drawn anew. */
  redraw(): void {
    this.tell("view");
  }

  private tick(now: number): void {
    if (!this.playing) return;
    // by time, not by calls: where drawing is slow frames are left out, and the speed holds
    const passed = ((now - this.clock) / 1000) * this.rate * this.speed;
    const target = this.times[this.index]! + passed;
    let next = this.index;
    while (next < this.last && this.times[next + 1]! <= target) next++;
    if (next !== this.index) {
      this.clock += ((this.times[next]! - this.times[this.index]!) / (this.rate * this.speed)) * 1000;
      this.seek(next);
    }
    if (this.index >= this.last) return this.pause();
    requestAnimationFrame((later) => this.tick(later));
  }
}
