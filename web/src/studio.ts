// The studio's page: a live scenario, driven by keys, a gamepad or a touch (sean_jax/web/studio/server.py).

import { Editor, type Edits } from "./edit";
import { Camera } from "./camera";
import { addMetrics, type Card, Comparison, type ComparisonNews } from "./compare";
import { COMMAND_INTERVAL, Controls, paintPicture } from "./drive";
import { DriveList, type DriveRow } from "./drives";
import { palette } from "./palette";
import { drawObstacles } from "./plan";
import { add, fit, Player } from "./player";
import { graphics, Scene } from "./scene";
import { type EpisodeHead, type Episode, type Place, type Recording, unpack } from "./recording";

interface Hello {
  recording: Recording;
  views: string[];
  policy: string;
  command: string;
  record: boolean;
  demonstrates: boolean; // whether drives of this robot become demonstrations
  options: Record<string, string | number>;
  choices: Record<string, string[]>;
  places: Record<string, Place>;
}

interface Status {
  you: "driver" | "watcher" | "free"; // this tab; free: there is no driver
  playing: boolean;
  human: boolean;
  speed: number;
  slowdown: number; // of the clock
  episode: number;
  tick: number;
  first: number; // the earliest moment to return to
  outcome: string;
  recording: boolean;
}

type News =
  | ({ kind: "hello" } & Hello)
  | { kind: "status"; content: Status }
  | { kind: "cut"; content: number }
  | { kind: "card"; content: Card }
  | { kind: "drives"; content: DriveRow[] }
  | { kind: "preparing"; content: string }
  | { kind: "comparison"; content: ComparisonNews }
  | { kind: "edit"; content: Edits }
  | { kind: "error"; content: string };

const SCENE = "3-D"; // a view that the page draws by itself
const AGAIN = 1500; // ms, until a page asks again for a studio that does not answer

/** The name of this tab, by which it gets its role back when it is loaded again. */
function tabName(): string {
  const key = "sean-studio-tab";
  let name = sessionStorage.getItem(key);
  if (!name) sessionStorage.setItem(key, (name = crypto.randomUUID()));
  return name;
}

const title = (view: string): string => view.replace("_", " ");

class Studio {
  private player: Player | null = null;
  private episode: Episode | null = null;
  private status: Status | null = null;
  private timeStep = 0.1;
  private sent = 0; // ms, time of the latest command
  private socket!: WebSocket;
  private hello: Hello | null = null;
  private readonly take: HTMLButtonElement;
  private readonly drives: DriveList;
  private readonly caption: HTMLElement; // of the picture
  private readonly note: HTMLElement;
  private readonly buttons: Record<"drive" | "record" | "step" | "next" | "live" | "edit", HTMLButtonElement>;
  private readonly controls: Controls;
  private readonly state: HTMLElement;
  private readonly card: HTMLElement;
  private readonly side: HTMLElement;
  private readonly form: HTMLDetailsElement;
  private readonly graphics = graphics();
  private scene: Scene | null = null;
  private readonly comparison: Comparison;
  private cards: Card[] = [];
  private editor: Editor | null = null;
  private readonly picture: HTMLCanvasElement;
  private readonly view: HTMLSelectElement;

  constructor(private readonly root: HTMLElement) {
    const bar = add(root, "div", "studio-bar");
    const button = (text: string, act: () => void): HTMLButtonElement => {
      const made = add(bar, "button");
      made.textContent = text;
      made.addEventListener("click", act);
      return made;
    };
    this.buttons = {
      drive: button("drive", () => this.takeOver()),
      step: button("step", () => this.request({ do: "step" })),
      live: button("newest moment", () => this.player?.toEdge()),
      record: button("record", () => this.request({ do: "record", on: !this.status?.recording })),
      edit: button("edit", () => this.buttons.edit.classList.toggle("on", this.editor?.toggle() ?? false)),
      next: button("next episode", () => this.request({ do: "episode", episode: (this.status?.episode ?? 0) + 1 })),
    };
    this.take = button("take the wheel", () => this.request({ do: "take" }));
    this.take.hidden = true;
    this.state = add(bar, "output", "studio-state");
    this.note = add(root, "p", "studio-note");
    this.note.setAttribute("role", "status");
    this.form = add(root, "details", "studio-open");
    this.comparison = new Comparison(add(root, "details", "studio-open"), (request) => {
      this.notify("");
      this.request(request);
    });
    this.drives = new DriveList(add(root, "details", "studio-open"), (request) => {
      this.notify("");
      this.request(request);
    });
    const stage = add(root, "div", "studio-stage");
    const place = add(stage, "div");
    this.side = add(stage, "div", "studio-side");
    const label = add(this.side, "label");
    label.append("view ");
    this.view = add(label, "select");
    this.view.addEventListener("change", () => {
      this.closeScene();
      this.showView();
      this.player?.redraw(false);
    });
    this.caption = add(this.side, "p", "studio-note");
    this.picture = add(this.side, "canvas");
    this.picture.hidden = true;
    this.picture.setAttribute("role", "img");
    this.picture.setAttribute("aria-label", "what the robot sees");
    this.card = add(this.side, "div", "studio-card");
    const joystick = add(root, "div", "studio-joystick");
    joystick.setAttribute("aria-hidden", "true"); // keys do the same
    this.controls = new Controls(joystick, () => this.sendCommand());
    this.controls.active = false;
    this.state.textContent = "connecting";
    this.notify("connecting to the studio");
    this.lock();
    this.connect(place);
    setInterval(() => this.sendCommand(), COMMAND_INTERVAL);
  }

  /** Open the socket; if it closes, ask again until the studio answers. */
  private connect(place: HTMLElement): void {
    const address = new URL("socket", location.href);
    address.search = location.search;
    address.searchParams.set("tab", tabName());
    address.protocol = "ws:";
    this.socket = new WebSocket(address);
    this.socket.binaryType = "arraybuffer";
    this.socket.addEventListener("message", (event) => this.receive(event.data as string | ArrayBuffer, place));
    this.socket.addEventListener("close", (event) => {
      const cure = this.hello?.record
        ? "this page goes on when it has started again"
        : "start it again and open the address that it prints";
      this.notify(event.reason ? `the studio has closed this tab: ${event.reason}` : `the studio does not answer; ${cure}`);
      this.root.dataset.open = "no";
      this.status = null;
      this.lock();
      setTimeout(() => this.connect(place), AGAIN);
    });
  }

  /** Let only the driver's tab, or any if there is no driver, ask for something. */
  private lock(): void {
    const locked = this.root.dataset.open !== "yes" || this.status?.you === "watcher";
    for (const name of ["drive", "step", "record", "edit", "next"] as const) this.buttons[name].disabled = locked;
    for (const panel of [this.form, ...this.root.querySelectorAll<HTMLElement>(".studio-compare, .studio-drives, .studio-edit")]) {
      panel.inert = locked;
    }
    this.player?.lock(locked);
    this.controls.active = !locked && this.isDriving();
    this.take.hidden = this.status?.you !== "watcher";
  }

  /** Whether the person of this tab drives. */
  private isDriving(): boolean {
    return this.status?.you === "driver" && this.status.human;
  }

  /** Whether a person drives, of this tab or of another one. */
  private isHuman(): boolean {
    return this.status?.human === true && this.status.you !== "free";
  }

  /** Ask for the picture of the view that is chosen; none is shown until it comes. */
  private showView(): void {
    const name = this.view.value;
    this.picture.hidden = name === "none" || name === SCENE;
    this.picture.width = this.picture.width; // nothing of another view stays
    this.caption.textContent = "";
    delete this.root.dataset.picture;
    this.request({ do: "view", name });
  }

  /** Send the person's command; keys have some effect at once. */
  private sendCommand(): void {
    const now = performance.now();
    this.nameButton();
    const [ahead, left] = this.controls.next(Math.max(COMMAND_INTERVAL, now - this.sent) / 1000);
    this.sent = now;
    if (this.isDriving() && this.status?.playing) this.request({ do: "command", ahead, left });
  }

  /** What the first button does now. */
  private nameButton(): void {
    const past = this.player?.moment && !this.player.moment.newest;
    this.buttons.drive.textContent = past ? "drive from here" : this.isHuman() ? "give back" : "drive";
    this.buttons.live.disabled = !past;
  }

  private request(request: Record<string, unknown>): void {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(request));
  }

  private notify(text: string): void {
    this.note.textContent = text;
  }

  /** From the moment that is shown; or give back to the policy. */
  private takeOver(): void {
    const moment = this.player?.moment;
    if (this.isHuman() && moment?.newest) {
      this.request({ do: "drive", on: false });
      return;
    }
    if (moment && !moment.newest) this.request({ do: "rewind", tick: moment.frame });
    this.player?.toEdge();
    this.request({ do: "drive", on: true });
    this.request({ do: "play", on: true });
  }

  private receive(data: string | ArrayBuffer, place: HTMLElement): void {
    if (typeof data !== "string") {
      this.grow(data);
      return;
    }
    const news = JSON.parse(data) as News;
    if (news.kind === "hello") this.begin(news, place);
    else if (news.kind === "status") this.show(news.content);
    else if (news.kind === "cut") this.cut(news.content);
    else if (news.kind === "card") this.showCards([...this.cards, news.content]);
    else if (news.kind === "drives") this.drives.show(news.content);
    else if (news.kind === "preparing") {
      if (news.content === this.view.value) this.caption.textContent = `preparing ${title(news.content)} (first time)`;
    }
    else if (news.kind === "comparison") this.comparison.show(news.content);
    else if (news.kind === "edit") {
      this.notify("");
      this.editor?.show(news.content);
      this.scene?.close(); // obstacles may have moved
      this.scene = null;
    } else {
      this.notify(news.content);
      this.editor?.refuse(news.content);
      this.comparison.refuse();
    }
  }

  /** The scenario's options, to open another one. */
  private options(hello: Hello): void {
    const opened = this.form.open;
    this.form.textContent = "";
    add(this.form, "summary").textContent = "open another scenario";
    const form = add(this.form, "form", "studio-fields");
    for (const [name, value] of Object.entries(hello.options)) {
      const label = add(form, "label");
      label.append(name);
      const choices = hello.choices[name];
      const input = choices ? add(label, "select") : add(label, "input");
      input.name = name;
      if (input instanceof HTMLSelectElement) {
        for (const each of new Set([...choices, String(value)])) input.add(new Option(each, each));
      } else {
        input.type = "number";
        input.min = "0";
      }
      input.value = String(value);
    }
    // a task belongs to a behavior: with another behavior, the usual one
    const field = (name: string): HTMLSelectElement => form.elements.namedItem(name) as HTMLSelectElement;
    field("task").add(new Option("as usual for the behavior", ""));
    field("behavior").addEventListener("change", () => (field("task").value = ""));
    field("environment").addEventListener("change", () => ((form.elements.namedItem("people") as HTMLInputElement).value = ""));
    const cards = document.createElement("div");
    cards.className = "studio-places";
    form.before(cards);
    for (const [name, place] of Object.entries(hello.places)) {
      const card = add(cards, "button");
      card.type = "button";
      const canvas = add(card, "canvas");
      add(card, "span").textContent = name;
      const [width, height] = [150, 110];
      canvas.style.width = `${width}px`;
      canvas.style.height = `${height}px`;
      const camera = new Camera(place.floor, width, height);
      drawObstacles(fit(canvas, width, height), camera, palette(canvas), place);
      card.addEventListener("click", () => {
        field("environment").value = name;
        field("environment").dispatchEvent(new Event("change"));
        for (const other of cards.children) other.classList.toggle("on", other === card);
      });
      card.classList.toggle("on", name === hello.options.environment);
    }
    add(form, "button").textContent = "open";
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const options: Record<string, string | number> = {};
      for (const [name, value] of new FormData(form)) options[name] = hello.choices[name] || value === "" ? String(value) : Number(value);
      this.notify("opening: this compiles for some seconds");
      this.request({ do: "open", options });
    });
    this.form.open = opened;
    const command = add(this.form, "p", "studio-command");
    add(command, "code").textContent = hello.command;
  }

  private closeScene(): void {
    this.scene?.close();
    this.scene = null;
  }

  private begin(hello: Hello, place: HTMLElement): void {
    this.hello = hello;
    this.drives.demonstrates = hello.demonstrates;
    this.player?.close();
    this.closeScene();
    this.episode = null;
    this.showCards([]);
    this.notify("");
    document.querySelector("h1")!.textContent = hello.recording.title;
    this.options(hello);
    const { policy, seed } = hello.options;
    this.comparison.begin(hello.choices.policy, String(policy), Number(seed), () => this.status?.episode ?? 0);
    const stage = document.createElement("div");
    place.replaceChildren(stage);
    this.timeStep = hello.recording.timeStep;
    this.player = new Player(stage, hello.recording, false, {
      play: (on) => this.request({ do: "play", on }),
      setSpeed: (speed) => this.request({ do: "speed", speed }),
    });
    this.player.drawn = (episode, time) => {
      if (this.view.value !== SCENE) return;
      this.scene ??= new Scene(this.side, hello.recording, episode.of("person x").length, this.graphics === "card");
      this.scene.draw(episode, time);
    };
    this.buttons.edit.classList.remove("on");
    this.editor?.close();
    this.editor = new Editor(this.side, this.player, hello.recording, (request, note) => {
      this.notify(note);
      this.request(request);
    });
    this.buttons.record.hidden = !hello.record;
    if (!this.view.length) {
      for (const name of ["none", ...hello.views]) this.view.add(new Option(title(name), name));
      const option = new Option(this.graphics ? SCENE : `${SCENE} (this browser has no WebGL)`, SCENE);
      option.disabled = !this.graphics;
      this.view.add(option, 1);
    }
    this.root.dataset.open = "yes";
    this.root.dataset.title = hello.recording.title;
    this.showView();
    this.lock();
  }

  private grow(data: ArrayBuffer): void {
    const length = new DataView(data).getUint32(0, true);
    const text = new TextDecoder().decode(new Uint8Array(data, 4, length));
    const bytes = new Uint8Array(data, 4 + length);
    if (JSON.parse(text).kind === "scan") {
      this.plot(JSON.parse(text) as { name: string; far: number }, bytes);
      return;
    }
    if (JSON.parse(text).kind === "picture") {
      this.paint(JSON.parse(text) as { name: string; width: number; height: number }, bytes);
      return;
    }
    const head = JSON.parse(text) as EpisodeHead & { first: number };
    const more = unpack(head, this.timeStep, bytes);
    if (!this.episode) {
      this.episode = more;
      this.player?.watch(more);
      return;
    }
    const skip = this.episode.frames - head.first;
    if (skip < 0 || skip >= more.frames) return; // frames that a newer message has made void
    this.episode.append(more, skip);
    this.player?.grow(this.episode);
    this.root.dataset.frames = String(this.episode.frames);
    this.root.dataset.speed = String(this.episode.of("speed")[0][this.episode.frames - 1]);
  }

  private paint(head: { name: string; width: number; height: number }, bytes: Uint8Array): void {
    if (head.name !== this.view.value) return; // of a view that was chosen before
    paintPicture(this.picture, head.width, head.height, bytes);
    this.nameView(head.name);
  }

  /** Name the picture that is shown. */
  private nameView(view: string): void {
    this.caption.textContent = title(view);
    this.root.dataset.picture = view;
  }

  /** A scan of the lidar, with ahead at the top; circles are 1 m apart, or 5 m. */
  private plot(head: { name: string; far: number }, bytes: Uint8Array): void {
    if (head.name !== this.view.value) return;
    const size = 240;
    const paint = fit(this.picture, size, size);
    const colors = palette(this.picture);
    const scale = size / 2 / head.far;
    const ring = head.far > 6 ? 5 : 1;
    [paint.strokeStyle, paint.fillStyle] = [colors.line, colors.robot];
    for (let radius = ring; radius <= head.far; radius += ring) {
      paint.beginPath();
      paint.arc(size / 2, size / 2, radius * scale, 0, 2 * Math.PI);
      paint.stroke();
    }
    const count = bytes.length / 2;
    for (let k = 0; k < count; k++) {
      const distance = (bytes[2 * k] + 256 * bytes[2 * k + 1]) / 1000;
      const angle = (2 * Math.PI * k) / count;
      const [x, y] = [size / 2 - distance * scale * Math.sin(angle), size / 2 - distance * scale * Math.cos(angle)];
      if (distance < head.far - 0.01) paint.fillRect(x - 1.5, y - 1.5, 3, 3);
    }
    this.nameView(head.name);
  }

  /** This drive beside policies on the same episode. */
  private showCards(cards: Card[]): void {
    this.cards = cards;
    this.card.textContent = "";
    if (!cards.length) return;
    addMetrics(this.card, "this episode", cards);
  }

  private cut(frames: number): void {
    this.showCards([]);
    if (!this.episode) return;
    if (frames === 0) this.episode = null;
    else {
      this.episode.cut(frames);
      this.player?.grow(this.episode);
    }
    this.player?.toEdge();
  }

  /** Who drives, in the words of this tab. */
  private driver(status: Status): string {
    const policy = this.hello?.policy ?? "the policy";
    if (status.you === "free") return "nobody has the wheel: the first tab that presses a button takes it";
    if (status.you === "watcher") return `watching · ${status.human ? "another tab drives" : `${policy} drives, another tab has the wheel`}`;
    return status.human ? "you drive" : `${policy} drives`;
  }

  private show(status: Status): void {
    this.status = status;
    this.player?.setClock(status.playing, status.speed);
    this.nameButton();
    this.buttons.record.textContent = status.recording ? "stop recording" : "record";
    this.buttons.record.classList.toggle("on", status.recording);
    this.root.dataset.human = status.human ? "yes" : "no";
    this.root.dataset.tick = String(status.tick);
    const late = status.slowdown > 1.2 ? ` · ${status.slowdown.toFixed(1)} times slower than asked` : "";
    this.state.textContent = status.outcome || `episode ${status.episode} · ${this.driver(status)}${late}`;
    this.root.dataset.you = status.you;
    this.lock();
    this.root.dataset.outcome = status.outcome;
  }
}

for (const root of document.querySelectorAll<HTMLElement>("[data-studio]")) new Studio(root);
