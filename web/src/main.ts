// The page: a plan view with its controls, a timeline, and the lights of the situations.

import { Camera } from "./camera";
import { palette, type Palette } from "./palette";
import { drawPlan, type Shown } from "./plan";
import { decode, type Episode, type Recording } from "./recording";
import { Stream } from "./stream";
import { drawTimeline, LABELS, timelineHeight } from "./timeline";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const POLL = 500; // ms

class Player {
  private episode!: Episode;
  private time = 0;
  private playing = false;
  private before = 0;
  private follow = false;
  private colors!: Palette;
  private stale = true; // something is to be drawn
  private readonly camera: Camera;
  private readonly shown: Shown = { trails: true, graph: false, sight: true };
  private readonly cache: Map<number, Promise<Episode>> = new Map();
  private number = 0;
  private stream: Stream | null = null;

  private readonly plan: HTMLCanvasElement;
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

    const lights = add(root, "div", "replay-lights");
    this.lights = recording.situations.map(({ name, color }) => {
      const light = add(lights, "span");
      light.textContent = name.replace(/_/g, " ");
      light.style.setProperty("--light", color);
      return light;
    });

    const controls = add(root, "div", "replay-controls");
    this.play = add(controls, "button");
    this.clock = add(controls, "output", "replay-clock");
    this.speed = add(controls, "select");
    this.speed.setAttribute("aria-label", "speed");
    for (const speed of SPEEDS) this.speed.add(new Option(`${speed} ×`, String(speed), speed === 4, speed === 4));
    const copy = add(controls, "button", "replay-link");
    copy.textContent = "link";
    copy.title = "a link to this moment";
    copy.hidden = !linked;

    const track = add(root, "div", "replay-track");
    this.line = add(track, "canvas");
    this.scrub = add(track, "input");
    this.scrub.type = "range";
    this.scrub.min = "0";
    this.scrub.step = "any";
    this.scrub.setAttribute("aria-label", "time");
    this.scrub.style.marginLeft = `${LABELS}px`;
    this.scrub.style.width = `calc(100% - ${LABELS}px)`;
    this.cursor = add(track, "div", "replay-cursor");

    this.play.addEventListener("click", () => this.run(!this.playing));
    this.scrub.addEventListener("input", () => this.seek(Number(this.scrub.value)));
    this.choice.addEventListener("change", () => void this.open(Number(this.choice.value), 0));
    copy.addEventListener("click", () => {
      this.address();
      void navigator.clipboard?.writeText(location.href).catch(() => undefined);
      copy.textContent = "copied";
      setTimeout(() => (copy.textContent = "link"), 1200);
    });
    root.addEventListener("keydown", (event) => this.key(event));
    if (linked) window.addEventListener("hashchange", () => void this.fromAddress());
    new ResizeObserver(() => this.resize()).observe(root);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.resize());
    this.run(false);
  }

  async start(): Promise<void> {
    if (this.recording.live) await this.listen(new Stream(this.recording.live, this.recording.timeStep));
    else if (!(this.linked && (await this.fromAddress()))) await this.open(0, 0);
    requestAnimationFrame((now) => this.tick(now));
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

  private grow(episode: Episode): void {
    this.episode = episode;
    this.scrub.max = String(episode.duration);
    this.resize();
    this.root.dataset.ready = "0";
    this.root.dataset.frames = String(episode.frames);
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
    this.root.dataset.ready = String(asked);
  }

  private async fromAddress(): Promise<boolean> {
    const asked = new URLSearchParams(location.hash.slice(1));
    if (!asked.has("episode") && !asked.has("t")) return false;
    await this.open(Number(asked.get("episode") ?? 0) || 0, Number(asked.get("t") ?? 0) || 0);
    return true;
  }

  private address(): void {
    const hash = `#episode=${this.number}&t=${this.time.toFixed(1)}`;
    try {
      history.replaceState(null, "", hash);
    } catch {
      // a page inside a page may have no address
    }
  }

  private run(on: boolean): void {
    if (on && !this.episode) return; // of a live one, before its first frame
    if (on && this.time >= this.episode.duration && !this.waits) this.time = 0;
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
    if (!this.episode) return; // the run ended before the first frame
    if (this.playing) {
      this.time += (Number(this.speed.value) * (now - this.before)) / 1000;
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
    this.clock.textContent = `${time.toFixed(1)} of ${episode.duration.toFixed(1)} s`;
    this.scrub.value = String(time);
    const share = time / Math.max(episode.duration, 1e-9);
    this.cursor.style.left = `${LABELS + share * (this.line.clientWidth - LABELS)}px`;
  }
}

function add<Name extends keyof HTMLElementTagNameMap>(
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
function fit(canvas: HTMLCanvasElement, width: number, height: number): CanvasRenderingContext2D {
  const fine = window.devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(width * fine));
  canvas.height = Math.max(1, Math.round(height * fine));
  const paint = canvas.getContext("2d")!;
  paint.setTransform(fine, 0, 0, fine, 0, 0);
  return paint;
}

for (const place of document.querySelectorAll<HTMLElement>("[data-replay]")) {
  const text = document.getElementById(place.dataset.replay!)!.textContent!;
  void new Player(place, JSON.parse(text) as Recording, place.dataset.linked !== "no").start();
}
