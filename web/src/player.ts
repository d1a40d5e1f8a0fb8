// A player: a plan view with its controls, and a timeline, whose labels are the lights of the situations.

import { Camera } from "./camera";
import { palette, type Palette } from "./palette";
import { describe, pick, placeOf, type Thing } from "./pick";
import { type Brush, drawPlan, TRAIL, type Shown } from "./plan";
import { decode, type Episode, type Recording } from "./recording";
import { Stream } from "./stream";
import { followTheme } from "./theme";
import { drawTimeline, LABELS, STRIP, timelineHeight } from "./timeline";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const POLL = 500; // ms
const TICK = 500; // ms, the longest between two pictures: a hidden tab draws none, and its film stands
const DRAG = 4; // pixels: a shorter one is a click
export const DIVERGENCE = 0.5; // m, between robots that have parted
const LEGEND = [
  ["robot-body", "robot, with its heading"],
  ["robot-ring", "its start; with a dot, its goal"],
  ["robot-plan", "its shortest path"],
  ["robot-sight", "what its depth camera can see"],
  ["robot-track", "its way, in the color of the situation"],
  ["person", "person; the dart or the nose points ahead"],
  ["member", "member of a group"],
  ["yielding", "person who yields: the robot is ahead within 2 m, and the speed below half of the usual one"],
  ["group", "a group that stands together"],
  ["trail", "people's last 3 seconds"],
];

/** How two robots part: when they are more than ``DIVERGENCE`` apart, or how near they stay. */
export interface Divergence {
  parted: boolean;
  time: number; // s
  apart: number; // m, then
}

/** What a live episode asks of its simulation. */
export interface Clock {
  play(on: boolean): void;
  setSpeed(speed: number): void;
}

export class Player {
  changed: (() => void) | null = null; // called when the viewer has changed episode, time, speed, or plays or pauses
  drawn: ((episode: Episode, time: number) => void) | null = null; // called with each moment [s] that is drawn
  private episode!: Episode;
  private time = 0;
  private playing = false;
  private before = 0;
  private follow = false;
  private colors!: Palette;
  private stale = true; // something is to be drawn
  private readonly camera: Camera;
  private readonly shown: Shown = { trails: true, graph: false, sight: true, person: -1 };
  private readonly cache: Map<number, Promise<Episode>> = new Map();
  private number = 0;
  private stream: Stream | null = null;
  private closed = false;
  private edge = false; // of a live episode, the newest moment is shown
  private arrival = 0; // ms, of its newest frame

  private pointer: [number, number] | null = null; // pixels of the plan
  private pinned: Thing | null = null; // by a click

  readonly plan: HTMLCanvasElement;
  private readonly tip: HTMLElement; // of what is below the pointer
  private readonly pin: HTMLElement; // of what a click has chosen
  private readonly line: HTMLCanvasElement;
  private readonly scrub: HTMLInputElement;
  private readonly cursor: HTMLElement;
  private readonly clock: HTMLElement;
  private readonly play: HTMLButtonElement;
  private readonly speed: HTMLSelectElement;
  private readonly choice: HTMLSelectElement;
  private readonly outcome: HTMLElement;
  private readonly lights: HTMLElement[];

  constructor(
    private readonly root: HTMLElement,
    private readonly recording: Recording,
    private readonly linked: boolean,
    private readonly live: Clock | null = null,
  ) {
    this.camera = new Camera(recording.place.floor);
    root.classList.add("replay");
    const bar = add(root, "div", "replay-bar");
    this.choice = add(bar, "select");
    this.choice.setAttribute("aria-label", "episode");
    recording.episodes.forEach((head, k) => this.choice.add(new Option(head.title, String(k))));
    this.choice.hidden = recording.episodes.length < 2;
    this.outcome = add(bar, "span", "replay-outcome");
    const toggles = add(bar, "span", "replay-toggles");
    for (const name of ["trails", "sight", "graph"] as const) {
      if ((name === "graph" && !recording.graph) || (name === "sight" && !recording.robot?.views.length)) continue;
      this.toggle(toggles, name, this.shown[name], (on) => (this.shown[name] = on));
    }
    if (recording.robot) {
      this.toggle(toggles, "follow", false, (on) => {
        this.follow = on;
        if (!on) this.camera.reset();
      });
    }

    this.plan = add(root, "canvas", "replay-plan");
    this.plan.tabIndex = 0;
    this.plan.setAttribute("role", "img");
    this.plan.setAttribute("aria-label", "plan of the episode from above");
    this.camera.listen(this.plan, () => (this.stale = true));
    this.pin = add(root, "div", "replay-pin");
    this.tip = add(root, "div", "replay-tip");
    for (const kind of ["pointermove", "pointerdown"] as const) {
      this.plan.addEventListener(kind, (event) => {
        this.pointer = [event.offsetX, event.offsetY];
        this.point();
      });
    }
    let down: [number, number] = [0, 0];
    this.plan.addEventListener("pointerdown", (event) => (down = [event.offsetX, event.offsetY]));
    this.plan.addEventListener("click", (event) => {
      if (Math.hypot(event.offsetX - down[0], event.offsetY - down[1]) < DRAG) this.choose(event.offsetX, event.offsetY);
    });
    this.plan.addEventListener("pointerleave", () => {
      this.pointer = null;
      this.point();
    });

    const legend = add(root, "div", "replay-legend");
    legend.hidden = true;
    for (const [kind, text] of LEGEND) {
      if (!recording.robot && (kind.startsWith("robot") || kind === "yielding")) continue;
      const entry = add(legend, "span");
      add(entry, "i", kind);
      entry.append(text);
    }
    this.toggle(toggles, "legend", false, (on) => (legend.hidden = !on));

    const controls = add(root, "div", "replay-controls");
    this.play = add(controls, "button");
    this.clock = add(controls, "output", "replay-clock");
    this.speed = add(controls, "select");
    this.speed.setAttribute("aria-label", "speed");
    const first = live ? 1 : 4;
    for (const speed of SPEEDS) this.speed.add(new Option(`${speed} ×`, String(speed), speed === first, speed === first));
    const copy = add(controls, "button", "replay-link");
    copy.textContent = "link";
    copy.title = "a link to this moment";
    copy.hidden = !linked;

    const track = add(root, "div", "replay-track");
    this.line = add(track, "canvas");
    this.lights = recording.situations.map(({ name, color }, index) => {
      const light = add(track, "span", "replay-light");
      light.textContent = name.replace(/_/g, " ");
      light.style.setProperty("--light", color);
      [light.style.top, light.style.width] = [`${index * STRIP}px`, `${LABELS - 8}px`];
      return light;
    });
    this.scrub = add(track, "input");
    this.scrub.type = "range";
    this.scrub.min = "0";
    this.scrub.step = "any";
    this.scrub.setAttribute("aria-label", "time");
    this.scrub.style.marginLeft = `${LABELS}px`;
    this.scrub.style.width = `calc(100% - ${LABELS}px)`;
    this.cursor = add(track, "div", "replay-cursor");

    this.play.addEventListener("click", () => this.toggleRun());
    this.speed.addEventListener("change", () => {
      live?.setSpeed(Number(this.speed.value));
      this.changed?.();
    });
    this.scrub.addEventListener("input", () => {
      this.edge = false;
      this.seek(Number(this.scrub.value));
      this.changed?.();
    });
    this.choice.addEventListener("change", () => {
      void this.open(Number(this.choice.value), 0).then(() => this.changed?.());
    });
    copy.addEventListener("click", () => {
      this.address();
      void navigator.clipboard?.writeText(location.href).catch(() => undefined);
      copy.textContent = "copied";
      setTimeout(() => (copy.textContent = "link"), 1200);
    });
    if (!live) root.addEventListener("keydown", (event) => this.key(event));
    if (linked) window.addEventListener("hashchange", () => void this.fromAddress());
    new ResizeObserver(() => this.resize()).observe(root);
    followTheme(() => this.resize());
    this.run(false);
  }

  /** Begin, at the first situation if `amid`. */
  async start(amid: boolean): Promise<void> {
    if (this.recording.live) await this.listen(new Stream(this.recording.live, this.recording.timeStep));
    else if (!(this.linked && (await this.fromAddress()))) {
      await this.open(0, 0);
      if (amid) this.seek(this.firstSituation());
      const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
      if (this.linked && new URLSearchParams(location.hash.slice(1)).has("play") && !still) this.run(true);
    }
    requestAnimationFrame((now) => this.tick(now));
  }

  /** s, when the robot is first in a situation, with people's trails behind them; the middle if it never is. */
  private firstSituation(): number {
    const flags = this.episode.of("situation").filter((_, k) => this.recording.situations[k].name !== "empty");
    for (let t = this.episode.frameAt(TRAIL); t < this.episode.frames; t++) {
      if (flags.some((flag) => flag[t] > 0.5)) return t * this.recording.timeStep;
    }
    return this.episode.duration / 2;
  }

  /** Play an episode while it is simulated; returns when there is a first frame. */
  private async listen(stream: Stream): Promise<void> {
    this.stream = stream;
    const again = async (): Promise<void> => {
      const came = await stream.poll();
      this.outcome.textContent = stream.outcome;
      if (came) this.grow(stream.episode!);
      if (!stream.over) setTimeout(() => void again(), POLL);
    };
    await again();
    while (!stream.episode && !stream.over) await new Promise((done) => setTimeout(done, POLL / 2));
    if (stream.episode) this.run(true);
  }

  /** Show a live episode from now on. */
  watch(episode: Episode): void {
    const first = !this.episode;
    this.edge = true;
    this.grow(episode);
    if (first) requestAnimationFrame((now) => this.tick(now));
  }

  /** Draw no more. */
  close(): void {
    this.closed = true;
  }

  /** What the simulation of a live episode does. */
  setClock(playing: boolean, speed: number): void {
    this.run(playing);
    this.speed.value = String(speed);
    this.arrival = performance.now();
  }

  /** The newest moment, also of frames to come. */
  toEdge(): void {
    this.edge = true;
    this.stale = true;
  }

  /** The place [m] on the plan below a pointer. */
  placeOf(event: MouseEvent): [number, number] {
    const box = this.plan.getBoundingClientRect();
    return this.camera.toPlan(event.clientX - box.left, event.clientY - box.top);
  }

  /** Metres of a pixel of the plan. */
  get pixel(): number {
    return 1 / this.camera.scale;
  }

  /** The pixel of the plan at a place [m]. */
  pixelOf(x: number, y: number): [number, number] {
    return this.camera.toScreen(x, y);
  }

  /** Draw more, on the floor and above all else; or nothing more. */
  drawMore(under?: Brush, over?: Brush): void {
    [this.shown.under, this.shown.over] = [under, over];
    this.stale = true;
  }

  /** Draw the recording anew, with the graph if `graph`. */
  redraw(graph: boolean): void {
    this.shown.graph ||= graph;
    this.stale = true;
  }

  /** The number of the frame that is shown, and whether it is the newest. */
  get moment(): { frame: number; newest: boolean } | null {
    return this.episode ? { frame: this.episode.frameAt(this.time), newest: this.edge } : null;
  }

  private toggleRun(): void {
    if (this.live) this.live.play(!this.playing);
    else this.run(!this.playing);
    this.changed?.();
  }

  /** The same episode and moment as another player's, at the same speed. */
  async copy(other: Player): Promise<void> {
    if (other.number !== this.number) await this.open(other.number, other.time);
    this.speed.value = other.speed.value;
    this.run(other.playing && other.time < this.episode.duration);
    this.seek(other.time);
  }

  /** When the robots of two players are half a metre apart for the first time, or else where they are furthest apart. */
  divergence(other: Player): Divergence | null {
    const columns = ["robot x", "robot y"].flatMap((name) => [this.episode.of(name)[0], other.episode.of(name)[0]]);
    if (columns.some((column) => !column)) return null;
    const [x, otherX, y, otherY] = columns;
    const frames = Math.min(this.episode.frames, other.episode.frames);
    let [most, when] = [0, 0];
    for (let t = 0; t < frames; t++) {
      const apart = Math.hypot(x[t] - otherX[t], y[t] - otherY[t]);
      if (apart > DIVERGENCE) return { parted: true, time: t * this.recording.timeStep, apart };
      if (apart > most) [most, when] = [apart, t];
    }
    return { parted: false, time: when * this.recording.timeStep, apart: most };
  }

  /** s, of the episode, at a time of the player. */
  clockOf(time: number): number {
    return time + this.episode.begin;
  }

  /** Let nothing be asked of the simulation of a live episode, or let it. */
  lock(on: boolean): void {
    this.play.disabled = on;
    this.speed.disabled = on;
  }

  /** Go to a time [s], and pause. */
  jump(time: number): void {
    this.run(false);
    this.seek(time);
    this.changed?.();
  }

  /** A button beside the speed, and a note behind it. */
  button(text: string, act: (note: HTMLElement) => void): void {
    const made = document.createElement("button");
    made.textContent = text;
    const note = document.createElement("output");
    made.addEventListener("click", () => act(note));
    this.speed.after(made, note);
  }

  grow(episode: Episode): void {
    this.arrival = performance.now();
    this.episode = episode;
    this.scrub.max = String(episode.duration);
    this.resize();
    this.root.dataset.ready = "0";
    this.root.dataset.frames = String(episode.frames);
  }

  /** What lies at a pixel of the plan. */
  private thingAt(px: number, py: number): Thing | null {
    if (!this.episode) return null;
    return pick(this.recording, this.episode, this.time, this.shown.graph, ...this.camera.toPlan(px, py), this.pixel);
  }

  /** Keep the description of what lies at a pixel until another click. */
  private choose(px: number, py: number): void {
    this.pinned = this.thingAt(px, py);
    this.shown.person = this.pinned?.kind === "person" ? this.pinned.index : -1;
    this.stale = true;
    this.point();
  }

  /** Describe what a click has chosen, and what is below the pointer. */
  private point(): void {
    const below = this.pointer && this.thingAt(...this.pointer);
    const { pinned } = this;
    const place = pinned && placeOf(pinned, this.recording, this.episode, this.time);
    this.label(this.pin, place && pinned, place ? this.camera.toScreen(...place) : [0, 0]);
    const same = below?.kind === pinned?.kind && below?.index === pinned?.index;
    this.label(this.tip, same ? null : below, this.pointer ?? [0, 0]);
  }

  private label(tip: HTMLElement, thing: Thing | null, [x, y]: [number, number]): void {
    tip.textContent = thing ? describe(thing, this.recording, this.episode, this.time) : "";
    if (!thing) return;
    const left = Math.max(0, Math.min(x + 12, this.plan.clientWidth - tip.offsetWidth));
    const top = Math.max(0, Math.min(y + 14, this.plan.clientHeight - tip.offsetHeight));
    [tip.style.left, tip.style.top] = [`${this.plan.offsetLeft + left}px`, `${this.plan.offsetTop + top}px`];
  }

  private toggle(place: HTMLElement, name: string, on: boolean, change: (on: boolean) => void): void {
    const label = add(place, "label");
    const box = add(label, "input");
    box.type = "checkbox";
    box.checked = on;
    label.append(name);
    box.addEventListener("change", () => {
      change(box.checked);
      this.stale = true;
    });
  }

  /** Show an episode from a time [s] on. */
  private async open(number: number, time: number): Promise<void> {
    this.number = Math.max(0, Math.min(this.recording.episodes.length - 1, number));
    if (this.episode && this.root.dataset.ready !== String(this.number)) [this.pinned, this.shown.person] = [null, -1];
    const asked = this.number;
    if (!this.cache.has(asked)) this.cache.set(asked, decode(this.recording.episodes[asked], this.recording.timeStep));
    const episode = await this.cache.get(asked)!;
    if (asked !== this.number) return; // another was chosen meanwhile
    this.episode = episode;
    this.choice.value = String(asked);
    this.outcome.textContent = episode.head.outcome;
    this.scrub.max = String(episode.duration);
    this.seek(time);
    this.resize();
    if (this.plan.clientWidth > 0) this.draw(); // what says ready shows this episode
    this.root.dataset.ready = String(asked);
  }

  private async fromAddress(): Promise<boolean> {
    const asked = new URLSearchParams(location.hash.slice(1));
    if (!asked.has("episode") && !asked.has("t")) return false;
    await this.open(Number(asked.get("episode") ?? 0) || 0, 0);
    this.seek((Number(asked.get("t") ?? 0) || 0) - this.episode.begin);
    return true;
  }

  private address(): void {
    const hash = `#episode=${this.number}&t=${this.clockOf(this.time).toFixed(1)}`;
    try {
      history.replaceState(null, "", hash);
    } catch {
      // a page inside a page may have no address
    }
  }

  private run(on: boolean): void {
    if (on && !this.episode) return; // of a live one, before its first frame
    if (on && this.time >= this.episode.duration && !this.waits && !this.live) this.time = 0;
    this.playing = on;
    this.before = performance.now();
    this.play.textContent = on ? "❚❚" : "▶";
    this.play.setAttribute("aria-label", on ? "pause" : "play");
  }

  /** Whether more frames will come. */
  private get waits(): boolean {
    return this.stream !== null && !this.stream.over;
  }

  private seek(time: number): void {
    if (!this.episode) return;
    this.time = Math.max(0, Math.min(this.episode.duration, time));
    this.stale = true;
  }

  private key(event: KeyboardEvent): void {
    if (event.target instanceof HTMLSelectElement || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = event.shiftKey ? 1 : this.recording.timeStep;
    const actions: Record<string, () => void> = {
      " ": () => this.run(!this.playing),
      ArrowRight: () => this.seek(this.time + step),
      ArrowLeft: () => this.seek(this.time - step),
      Home: () => this.seek(0),
      End: () => this.seek(this.episode.duration),
    };
    const action = actions[event.key];
    if (!action || (event.key === " " && event.target instanceof HTMLButtonElement)) return;
    event.preventDefault();
    if (event.key !== " ") this.run(false);
    action();
    this.changed?.();
  }

  private resize(): void {
    if (!this.episode) return;
    this.colors = palette(this.root);
    const width = this.plan.clientWidth;
    const [x0, y0, x1, y1] = this.recording.place.floor;
    const height = Math.max(220, Math.min(640, (width * (y1 - y0)) / (x1 - x0)));
    this.plan.style.height = `${height}px`;
    fit(this.plan, width, height);
    this.camera.resize(width, height);
    const tall = timelineHeight(this.recording);
    this.line.style.height = `${tall}px`;
    const paint = fit(this.line, this.line.clientWidth, tall);
    drawTimeline(paint, this.line.clientWidth, this.colors, this.recording, this.episode);
    this.stale = true;
  }

  private tick(now: number): void {
    if (!this.episode || this.closed) return; // the run ended before the first frame
    if (this.live) {
      const ahead = this.playing ? (Number(this.speed.value) * (now - this.arrival)) / 1000 : 0;
      if (this.edge) this.time = this.episode.duration + Math.max(0, Math.min(this.recording.timeStep, ahead));
      this.stale ||= this.edge && this.playing;
    } else if (this.playing) {
      this.time += (Number(this.speed.value) * Math.min(now - this.before, TICK)) / 1000;
      this.stale = true;
      if (this.time >= this.episode.duration) {
        this.time = this.episode.duration;
        if (!this.waits) this.run(false);
      }
    }
    this.before = now;
    if (this.stale && this.plan.clientWidth > 0) {
      this.stale = false;
      this.draw();
    }
    requestAnimationFrame((next) => this.tick(next));
  }

  private draw(): void {
    const { episode, time } = this;
    const paint = this.plan.getContext("2d")!;
    paint.clearRect(0, 0, this.plan.clientWidth, this.plan.clientHeight);
    if (this.follow) {
      this.camera.follow(episode.at(episode.of("robot x")[0], time), episode.at(episode.of("robot y")[0], time));
    }
    drawPlan(paint, this.camera, this.colors, this.recording, episode, time, this.shown);
    const frame = episode.frameAt(time);
    episode.of("situation").forEach((flag, k) => this.lights[k].classList.toggle("on", flag[frame] > 0.5));
    if (this.pointer || this.pinned) this.point();
    this.drawn?.(episode, time);
    const [now, end] = [Math.min(time, episode.duration), episode.duration].map((each) => this.clockOf(each).toFixed(1));
    this.clock.textContent = `${now} of ${end} s`;
    this.scrub.value = String(Math.min(time, episode.duration));
    const share = Math.min(1, time / Math.max(episode.duration, 1e-9));
    this.cursor.style.left = `${LABELS + share * (this.line.clientWidth - LABELS)}px`;
  }
}

export function add<Name extends keyof HTMLElementTagNameMap>(
  parent: HTMLElement,
  name: Name,
  kind = "",
): HTMLElementTagNameMap[Name] {
  const element = document.createElement(name);
  if (kind) element.className = kind;
  parent.append(element);
  return element;
}

/** A canvas of that size in pixels of the screen, and its brush in those of the page. */
export function fit(canvas: HTMLCanvasElement, width: number, height: number): CanvasRenderingContext2D {
  const fine = window.devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(width * fine));
  canvas.height = Math.max(1, Math.round(height * fine));
  const paint = canvas.getContext("2d")!;
  paint.setTransform(fine, 0, 0, fine, 0, 0);
  return paint;
}
