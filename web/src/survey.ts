// The pages of a study: a participant's, step by step, and the researcher's (sean_jax/studies/survey/server.py).

import { COMMAND_INTERVAL, Controls, paintPicture } from "./drive";
import { add, Player } from "./player";
import { type Episode, type EpisodeHead, type Recording, unpack } from "./recording";

interface Question {
  kind: "likert" | "choice" | "text" | "number";
  name: string;
  text: string;
  group: string; // what is asked of all items of a questionnaire
  required: boolean;
  points: number;
  ends: [string, string];
  choices: string[];
  range: [number, number] | null;
}

interface Head {
  title: string;
  number: number; // of the step, from 0 on
  count: number;
}

interface Step extends Head {
  what: "questions" | "watch" | "drive" | "choose";
  text: string;
  view: string;
  shown: boolean; // the episode is over, and questions follow
  recordings: Recording[];
  rules: { limit: number; hold: number } | null; // of a drive: s, until it ends, and for which the robot has to stay
  questions: Question[];
  answers: Record<string, string | number>;
}

interface Progress {
  id: number;
  consented: number | null; // s since 1970
  finished: number | null;
  seen: number | null;
  done: number;
  steps: number;
  open: boolean;
  drives: boolean;
}

type News =
  | ({ kind: "consent"; text: string } & Head)
  | ({ kind: "end"; text: string } & Head)
  | ({ kind: "step" } & Step)
  | { kind: "stored"; content: string }
  | { kind: "missing"; content: string[] }
  | { kind: "wait" | "error"; content: string }
  | { kind: "shown"; content: number } // the film has been watched, and questions follow
  | { kind: "early"; content: number } // s, until the film has been watched
  | { kind: "go"; content: number }
  | { kind: "over"; content: string }
  | { kind: "study"; title: string; links: string[]; tables: string[] }
  | { kind: "progress"; content: Progress[] };

const REPLACED = 4000; // code of a socket whose study is open in another tab
const PAUSE = 1000; // ms, until a lost connection is tried again
const TYPING = 600; // ms after the last key, until a text is stored
const LOOK = 150; // ms, between two looks at a player
const SOON = 200; // ms after the end of a film by the server's clock, until the page asks again
const PROMPT: Record<string, string> = {
  watch: "Watch the robot. It is orange.",
  choose: "Watch both robots. They are orange.",
};
const GOAL = {
  plan: "Drive the orange robot to its goal, the ring with a dot, and stay there.",
  picture: "Drive the robot to its goal, and stay there. The arrow points to the goal; up is ahead.",
};
const KEYS = "Use the arrow keys, or W, A, S and D; on a touch screen, the joystick.";
const OUTCOMES: Record<string, string> = { completed: "You have reached the goal.", "timed out": "The time is over." };

/** A sentence that says when a drive ends. */
function rules({ limit, hold }: { limit: number; hold: number }): string {
  const seconds = (number: number): string => `${number} second${number === 1 ? "" : "s"}`;
  const stay = hold > 0 ? `has stayed at the goal for ${seconds(hold)} without a break` : "is at the goal";
  return `You have ${seconds(limit)}. The drive ends when the robot ${stay}, or when the time is over.`;
}

class Survey {
  private socket!: WebSocket;
  private step: Step | null = null;
  private players: Player[] = [];
  private episode: Episode | null = null;
  private driving = false;
  private sent = 0; // ms, time of the latest command
  private links: string[] = [];
  private readonly typing = new Map<string, () => void>(); // texts that are not yet sent
  private readonly bar: HTMLElement;
  private readonly note: HTMLElement;
  private readonly place: HTMLElement;
  private readonly joystick: HTMLElement;
  private readonly controls: Controls;
  private picture: HTMLCanvasElement | null = null;
  private compass: HTMLElement | null = null;
  private watcher = 0;
  private began = false; // the film
  private waiting = 0; // for the server, which thinks that the film has not ended

  constructor(private readonly root: HTMLElement) {
    this.bar = add(root, "p", "survey-progress");
    this.note = add(root, "p", "studio-note");
    this.note.setAttribute("role", "status");
    this.place = add(root, "div");
    this.joystick = add(root, "div", "studio-joystick");
    this.joystick.setAttribute("aria-hidden", "true"); // keys do the same
    this.controls = new Controls(this.joystick, () => this.sendCommand());
    this.steer(false);
    setInterval(() => this.sendCommand(), COMMAND_INTERVAL);
    document.addEventListener("visibilitychange", () => this.request(document.hidden ? "hidden" : "visible"));
    this.connect();
  }

  private connect(): void {
    const address = new URL("socket", location.href);
    address.search = location.search;
    address.protocol = location.protocol.replace("http", "ws");
    this.socket = new WebSocket(address);
    this.socket.binaryType = "arraybuffer";
    this.socket.addEventListener("open", () => document.hidden && this.request("hidden"));
    this.socket.addEventListener("message", (event) => this.receive(event.data as string | ArrayBuffer));
    this.socket.addEventListener("close", (event) => {
      this.steer(false);
      this.root.dataset.open = "no";
      if (event.code === REPLACED) {
        this.clear();
        this.notify("This study is open in another tab. Close this one.");
        return;
      }
      this.notify("There is no connection to the study. This page tries again.");
      setTimeout(() => this.connect(), PAUSE);
    });
  }

  private request(word: string, more: Record<string, unknown> = {}): void {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.socket.send(JSON.stringify({ do: word, step: this.step?.number, ...more }));
  }

  private sendCommand(): void {
    const now = performance.now();
    const [ahead, left] = this.controls.next(Math.max(COMMAND_INTERVAL, now - this.sent) / 1000);
    this.sent = now;
    if (this.driving) this.request("command", { ahead, left });
  }

  private notify(text: string): void {
    this.note.textContent = text;
  }

  /** Whether keys and the joystick drive. */
  private steer(on: boolean): void {
    this.driving = this.controls.active = on;
    this.joystick.hidden = !on;
    this.root.dataset.driving = on ? "yes" : "no";
  }

  private receive(data: string | ArrayBuffer): void {
    if (typeof data !== "string") {
      this.grow(data);
      return;
    }
    const news = JSON.parse(data) as News;
    if (news.kind === "consent") this.ask(news);
    else if (news.kind === "step") this.open(news);
    else if (news.kind === "end") this.end(news);
    else if (news.kind === "stored") this.mark(news.content);
    else if (news.kind === "shown") {
      if (this.step?.number === news.content) this.show(this.step);
    } else if (news.kind === "early") this.wait(news.content);
    else if (news.kind === "missing") this.complain(news.content);
    else if (news.kind === "study") this.listLinks(news.title, news.links, news.tables);
    else if (news.kind === "progress") this.listProgress(news.content);
    else if (news.kind === "go") {
      this.notify("Drive now.");
      this.players[0]?.setClock(true, 1);
      this.players[0]?.toEdge();
      this.steer(true);
    } else if (news.kind === "over") {
      this.steer(false);
      this.players[0]?.setClock(false, 1);
      this.notify(OUTCOMES[news.content] ?? news.content);
      if (this.step) this.show(this.step);
    } else this.notify(news.content);
  }

  private clear(): void {
    clearInterval(this.watcher);
    clearTimeout(this.waiting);
    this.began = false;
    for (const player of this.players) player.close();
    this.players = [];
    this.episode = this.picture = this.compass = null;
    this.typing.clear();
    this.steer(false);
    this.place.textContent = "";
    this.notify("");
  }

  private page(name: string, head: Head): void {
    this.clear();
    this.bar.textContent = name === "step" ? `part ${head.number + 1} of ${head.count}` : "";
    this.root.dataset.open = "yes";
    this.root.dataset.page = name;
    this.root.dataset.step = String(head.number);
    window.scrollTo(0, 0);
  }

  private button(place: HTMLElement, text: string, act: () => void): HTMLButtonElement {
    const made = add(place, "button", "survey-next");
    made.type = "button";
    made.textContent = text;
    made.addEventListener("click", act);
    return made;
  }

  private paragraphs(text: string): void {
    for (const each of text.trim().split(/\n\s*\n/)) add(this.place, "p", "survey-text").textContent = each;
  }

  private ask(news: Head & { text: string }): void {
    this.page("consent", news);
    this.step = null;
    this.paragraphs(news.text);
    this.button(this.place, "I agree, begin", () => this.request("consent"));
  }

  private end(news: Head & { text: string }): void {
    this.page("end", news);
    this.step = null;
    this.paragraphs(news.text);
  }

  /** Go on after so many seconds, in which the server expects the film to end. */
  private wait(seconds: number): void {
    this.notify("One moment, please.");
    clearTimeout(this.waiting);
    this.waiting = window.setTimeout(() => this.request("shown"), 1000 * seconds + SOON);
  }

  /** Whether a film is shown that has not been watched yet. */
  private get filming(): boolean {
    return (this.step?.what === "watch" || this.step?.what === "choose") && !this.place.querySelector("form");
  }

  private open(step: Step): void {
    if (this.filming && this.step?.number === step.number && !step.shown) {
      this.root.dataset.open = "yes"; // the connection was lost, and the film goes on
      this.notify("");
      if (this.began) this.request("began");
      return;
    }
    this.page("step", step);
    this.step = step;
    this.root.dataset.what = step.what;
    if (step.text && step.what !== "choose") this.paragraphs(step.text);
    if (step.what === "drive") this.prepareDrive(step);
    else if (step.what !== "questions") this.play(step);
    if (step.shown) this.show(step);
  }

  // ------------------------------------------------------------------ episodes

  private play(step: Step): void {
    if (!step.shown) add(this.place, "p", "survey-text").textContent = PROMPT[step.what];
    const both = add(this.place, "div", step.recordings.length > 1 ? "both" : "");
    step.recordings.forEach((recording, k) => {
      const box = add(both, "div");
      if (step.recordings.length > 1) add(box, "h2").textContent = "AB"[k];
      const stage = add(box, "div");
      // an episode is watched as it is: no jumps
      stage.addEventListener("keydown", (event) => event.key !== " " && event.stopPropagation(), true);
      const player = new Player(stage, recording, false);
      stage.querySelector<HTMLSelectElement>("[aria-label=speed]")!.value = "1";
      this.players.push(player);
      void player.start(false);
    });
    for (const player of this.players) {
      const others = this.players.filter((other) => other !== player);
      player.changed = () => others.forEach((other) => void other.copy(player));
    }
    if (step.shown) return;
    const next = this.button(this.place, "continue", () => this.request("shown"));
    next.disabled = true;
    this.watcher = window.setInterval(() => {
      if (!this.began && this.players.some((player) => (player.moment?.frame ?? 0) > 0)) {
        this.began = true;
        this.request("began");
      }
      const over = this.players.every((player, k) => {
        const frames = step.recordings[k].episodes[0].frames;
        return (player.moment?.frame ?? 0) >= frames - 1;
      });
      if (over) next.disabled = false;
    }, LOOK);
  }

  private prepareDrive(step: Step): void {
    if (step.shown) return;
    const goal = step.view === "plan" ? GOAL.plan : GOAL.picture;
    add(this.place, "p", "survey-text").textContent = `${goal} ${KEYS}`;
    if (step.rules) add(this.place, "p", "survey-text").textContent = rules(step.rules);
    const start = this.button(this.place, "start", () => {
      start.disabled = true;
      this.request("start");
    });
    start.classList.add("survey-start"); // stays, so that nothing moves
    if (step.view === "plan") {
      const stage = add(this.place, "div");
      this.players = [new Player(stage, step.recordings[0], false, { play: () => undefined, setSpeed: () => undefined })];
      return;
    }
    this.compass = add(this.place, "p", "survey-compass");
    this.picture = add(this.place, "canvas", "survey-picture");
    this.picture.setAttribute("role", "img");
    this.picture.setAttribute("aria-label", "what the robot sees");
  }

  private grow(data: ArrayBuffer): void {
    const length = new DataView(data).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))) as EpisodeHead & {
      kind: string;
      first: number;
      width: number;
      height: number;
    };
    const bytes = new Uint8Array(data, 4 + length);
    if (!this.step) return;
    if (head.kind === "picture") {
      if (this.picture) paintPicture(this.picture, head.width, head.height, bytes);
      return;
    }
    const more = unpack(head, this.step.recordings[0].timeStep, bytes);
    if (!this.episode) {
      this.episode = more;
      this.players[0]?.watch(more);
    } else {
      const skip = this.episode.frames - head.first;
      if (skip < 0 || skip >= more.frames) return;
      this.episode.append(more, skip);
      this.players[0]?.grow(this.episode);
    }
    this.root.dataset.frames = String(this.episode.frames);
    this.point(this.episode);
  }

  /** Where the goal is, for a view in which it may be behind the robot. */
  private point(episode: Episode): void {
    if (!this.compass) return;
    const [x, y, heading, goalX, goalY] = ["robot x", "robot y", "robot heading", "goal x", "goal y"].map(
      (name) => episode.of(name)[0][episode.frames - 1],
    );
    const left = Math.atan2(goalY - y, goalX - x) - heading;
    this.compass.textContent = `goal: ${Math.hypot(goalX - x, goalY - y).toFixed(1)} m `;
    const arrow = add(this.compass, "span");
    arrow.textContent = "↑";
    arrow.style.transform = `rotate(${-left}rad)`;
  }

  // ------------------------------------------------------------------ questions

  private show(step: Step): void {
    if (this.place.querySelector("form")) return;
    for (const button of this.place.querySelectorAll(".survey-next:not(.survey-start)")) button.remove();
    const form = add(this.place, "form", "survey-questions");
    form.noValidate = true;
    let group = "";
    for (const question of step.questions) {
      if (question.group !== group) {
        group = question.group;
        if (group) add(form, "h2").textContent = group;
      }
      this.question(form, question, step.answers[question.name]);
    }
    add(form, "button", "survey-next").textContent = step.number + 1 === step.count ? "finish" : "next";
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      for (const send of [...this.typing.values()]) send();
      this.request("done");
    });
    this.root.dataset.form = String(step.questions.length);
  }

  private question(form: HTMLElement, question: Question, answer: string | number | undefined): void {
    const send = (value: string | number | null): void => {
      step.answers[question.name] = value ?? "";
      this.request("answer", { question: question.name, value });
    };
    const step = this.step!;
    const text = question.required ? question.text : `${question.text} (optional)`;
    const isRow = question.kind === "likert";
    if (isRow || question.kind === "choice") {
      const set = add(form, "fieldset", `survey-question ${isRow ? "survey-likert" : ""}`);
      set.dataset.question = question.name;
      add(set, "legend").textContent = text;
      const values = isRow ? Array.from({ length: question.points }, (_, k) => k + 1) : question.choices;
      const row = add(set, "div", isRow ? "survey-row" : "");
      values.forEach((value, k) => {
        const label = add(row, "label");
        const radio = add(label, "input");
        radio.type = "radio";
        radio.name = question.name;
        radio.value = String(value);
        radio.checked = answer === value;
        label.append(String(value));
        const end = !isRow ? "" : k === 0 ? question.ends[0] : k === values.length - 1 ? question.ends[1] : "";
        if (end) radio.setAttribute("aria-label", `${value}, ${end}`);
        radio.addEventListener("change", () => send(value));
      });
      if (isRow) {
        const ends = add(set, "p", "survey-ends");
        ends.setAttribute("aria-hidden", "true"); // in the labels of the first and the last point
        for (const end of question.ends) add(ends, "span").textContent = end;
      }
      return;
    }
    const label = add(form, "label", "survey-question");
    label.dataset.question = question.name;
    add(label, "span").textContent = text;
    const input = question.kind === "text" ? add(label, "textarea") : add(label, "input");
    if (input instanceof HTMLInputElement) {
      input.type = "number";
      input.step = "any";
      if (question.range) [input.min, input.max] = question.range.map(String);
    } else {
      input.rows = 4;
      input.maxLength = 2000;
    }
    input.value = answer === undefined ? "" : String(answer);
    let timer = 0;
    input.addEventListener("input", () => {
      clearTimeout(timer);
      const now = (): void => {
        clearTimeout(timer);
        this.typing.delete(question.name);
        send(input.value === "" ? null : question.kind === "number" ? Number(input.value) : input.value);
      };
      this.typing.set(question.name, now);
      timer = window.setTimeout(now, TYPING);
    });
  }

  private mark(name: string): void {
    const place = this.place.querySelector<HTMLElement>(`[data-question="${CSS.escape(name)}"]`);
    if (place) place.dataset.stored = "yes";
    place?.classList.remove("missing");
    if (!this.place.querySelector(".missing")) this.notify("");
    this.root.dataset.stored = String(this.place.querySelectorAll("[data-stored]").length);
  }

  private complain(names: string[]): void {
    const places = names.map((name) => this.place.querySelector<HTMLElement>(`[data-question="${CSS.escape(name)}"]`));
    for (const place of places) place?.classList.add("missing");
    this.notify(names.length === 1 ? "One question has no answer yet." : `${names.length} questions have no answer yet.`);
    places[0]?.querySelector<HTMLElement>("input, textarea")?.focus();
    places[0]?.scrollIntoView({ block: "center" });
  }

  // ------------------------------------------------------------------ the researcher

  private listLinks(title: string, links: string[], tables: string[]): void {
    this.page("researcher", { title, number: 0, count: 0 });
    this.links = links;
    const files = add(this.place, "p", "survey-text");
    for (const name of tables) {
      const link = add(files, "a");
      link.href = `${name}${location.search}`;
      link.download = name;
      link.textContent = name;
      files.append(" ");
    }
    const wide = add(this.place, "div", "wide");
    wide.tabIndex = 0;
    const table = add(wide, "table");
    const top = add(add(table, "thead"), "tr");
    for (const text of ["participant", "state", "minutes", "latest event", "link"]) {
      const cell = add(top, "th");
      cell.scope = "col";
      cell.textContent = text;
    }
    add(table, "tbody");
  }

  private listProgress(rows: Progress[]): void {
    const body = this.place.querySelector("tbody");
    if (!body) return;
    const moment = (seconds: number): string => new Date(1000 * seconds).toLocaleTimeString();
    for (const row of rows) {
      const cells = (body.children[row.id] ?? this.line(body, row.id)).children;
      const part = `part ${row.done + 1} of ${row.steps}`;
      const where = row.finished ? "finished" : row.consented ? part : row.seen ? "reads the consent" : "not begun";
      const last = row.finished ?? row.seen;
      cells[1].textContent = `${where}${row.drives ? ", drives" : row.open ? ", page open" : ""}`;
      cells[2].textContent = row.consented && last ? (Math.max(0, last - row.consented) / 60).toFixed(1) : "";
      cells[3].textContent = row.seen ? moment(Math.max(row.seen, row.finished ?? 0)) : "";
    }
    this.root.dataset.finished = String(rows.filter((row) => row.finished).length);
  }

  /** The row of a participant, who has a link to copy. */
  private line(body: HTMLElement, number: number): HTMLElement {
    const line = add(body, "tr");
    const name = add(line, "th");
    name.scope = "row";
    name.textContent = String(number + 1);
    for (let k = 0; k < 3; k++) add(line, "td");
    const copy = this.button(add(line, "td"), "copy link", () => {
      void navigator.clipboard?.writeText(this.links[number]).catch(() => undefined);
      copy.textContent = "copied";
    });
    copy.title = this.links[number];
    return line;
  }
}

for (const root of document.querySelectorAll<HTMLElement>("[data-survey]")) new Survey(root);
