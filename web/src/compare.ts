// Two episodes side by side on one clock, and their metrics.

import { add, DIVERGENCE, Player } from "./player";
import type { Recording } from "./recording";

const BEFORE = 2; // s, before two robots part
const ROWS: [string, string, number][] = [
  ["completed", "completed", 0],
  ["seconds", "time, s", 1],
  ["path_length", "path at 1 Hz, m", 1],
  ["time_not_moving", "not moving at 1 Hz, s", 1],
  ["intimate_robot_on_person", "closer than 0.45 m, robot's fault", 0],
  ["intimate_person_on_robot", "closer than 0.45 m, person's fault", 0],
  ["collision_robot_on_person", "people touched", 0],
  ["collision_with_obstacle", "obstacles touched", 0],
];

/** Let players show the same moment; two of them can go to where their robots part. */
export function shareClock(players: Player[]): void {
  for (const player of players) {
    const others = players.filter((other) => other !== player);
    player.changed = () => others.forEach((other) => void other.copy(player));
  }
  if (players.length !== 2) return;
  const [one, other] = players;
  one.button("where they part", (note) => {
    const found = one.divergence(other);
    if (!found) {
      note.textContent = "there is no robot";
    } else if (found.parted) {
      note.textContent = "";
      one.jump(Math.max(0, found.time - BEFORE));
    } else {
      const most = `${found.apart.toFixed(2)} m at ${one.clockOf(found.time).toFixed(1)} s`;
      note.textContent = `they stay within ${DIVERGENCE} m of each other (at most ${most})`;
    }
  });
}

export interface Card {
  driver: string;
  metrics: Record<string, number>;
}

/** A table of metrics with a column for each card. */
export function addMetrics(place: HTMLElement, title: string, cards: Card[]): void {
  place.tabIndex = 0; // it scrolls if it is narrow
  const table = add(place, "table");
  const top = add(add(table, "thead"), "tr");
  add(top, "th").textContent = title;
  for (const card of cards) add(top, "th").textContent = card.driver;
  const body = add(table, "tbody");
  for (const [name, text, digits] of ROWS) {
    const row = add(body, "tr");
    const head = add(row, "th");
    head.textContent = text;
    head.scope = "row";
    for (const { metrics } of cards) {
      const value = metrics[name];
      const cell = add(row, "td");
      if (name === "completed") cell.textContent = value ? "yes" : "no";
      else cell.textContent = value === undefined ? "–" : value.toFixed(digits);
    }
  }
  add(place, "p", "studio-note").textContent = "1 Hz: as in SEAN, from the robot's places once a second";
}

export type ComparisonNews =
  | { index: number; seconds: number; limit: number }
  | { recordings: Recording[]; metrics: Record<string, number>[] };

/** The panel of the studio in which two episodes of the open scenario are compared. */
export class Comparison {
  private players: Player[] = [];
  private readonly form: HTMLFormElement;
  private readonly submit: HTMLButtonElement;
  private readonly note: HTMLElement;
  private readonly bar: HTMLProgressElement;
  private readonly result: HTMLElement;

  constructor(
    private readonly panel: HTMLDetailsElement,
    private readonly request: (request: Record<string, unknown>) => void,
  ) {
    add(panel, "summary").textContent = "compare two episodes";
    this.form = add(panel, "form", "studio-compare");
    this.note = document.createElement("output");
    this.bar = document.createElement("progress");
    this.bar.setAttribute("aria-label", "progress");
    this.submit = document.createElement("button");
    this.submit.textContent = "simulate both";
    this.result = add(panel, "div");
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.clear();
      this.wait(true);
      this.note.textContent = "compiling";
      request({ do: "compare", choices: ["first", "second"].map((name) => this.choice(name)) });
    });
    panel.addEventListener("toggle", () => panel.open || this.stop());
  }

  /** Offer the policies of a scenario. */
  begin(policies: string[], policy: string, seed: number, episode: () => number): void {
    this.stop();
    this.form.textContent = "";
    const numbers: HTMLInputElement[] = [];
    for (const name of ["first", "second"]) {
      const fields = add(this.form, "fieldset", "studio-fields");
      add(fields, "legend").textContent = name;
      const label = (text: string): HTMLLabelElement => {
        const made = add(fields, "label");
        made.append(text);
        return made;
      };
      const select = add(label("policy"), "select");
      select.name = `${name} policy`;
      for (const each of new Set([...policies, policy])) select.add(new Option(each, each));
      select.value = name === "first" ? policy : (policies.find((each) => each !== policy) ?? policy);
      for (const [key, value] of [["seed", seed], ["episode", 0]] as const) {
        const input = add(label(key), "input");
        input.type = "number";
        input.min = "0";
        input.required = true;
        input.name = `${name} ${key}`;
        input.value = String(value);
        if (key === "episode") numbers.push(input);
      }
    }
    const row = add(this.form, "div", "studio-bar");
    row.append(this.submit, this.bar, this.note);
    this.panel.ontoggle = () => this.panel.open && numbers.forEach((input) => (input.value = String(episode())));
  }

  /** Progress, or the result. */
  show(news: ComparisonNews): void {
    if (!this.panel.open) return;
    if ("index" in news) {
      [this.bar.max, this.bar.value] = [2 * news.limit, news.index * news.limit + news.seconds];
      this.note.textContent = `${["first", "second"][news.index]}: ${news.seconds.toFixed(0)} of at most ${news.limit} s`;
      return;
    }
    this.clear();
    this.wait(false);
    const titles = news.recordings.map(({ title }) => title);
    const both = add(this.result, "div", "both");
    this.players = news.recordings.map((recording) => {
      const place = add(both, "div");
      add(place, "h2").textContent = recording.title;
      return new Player(add(place, "div"), recording, false);
    });
    for (const player of this.players) void player.start(false);
    shareClock(this.players);
    const table = add(this.result, "div", "studio-card");
    addMetrics(table, "whole episodes", news.metrics.map((metrics, k) => ({ driver: titles[k], metrics })));
  }

  /** The server has refused. */
  refuse(): void {
    this.wait(false);
  }

  private choice(name: string): Record<string, string | number> {
    const data = new FormData(this.form);
    const value = (key: string): string => String(data.get(`${name} ${key}`));
    return { policy: value("policy"), seed: Number(value("seed")), episode: Number(value("episode")) };
  }

  private wait(on: boolean): void {
    this.submit.disabled = on;
    this.bar.hidden = !on;
    this.bar.value = 0;
    if (!on) this.note.textContent = "";
  }

  private clear(): void {
    for (const player of this.players) player.close();
    this.players = [];
    this.result.textContent = "";
  }

  private stop(): void {
    if (this.submit.disabled) this.request({ do: "compare", choices: [] });
    this.clear();
    this.wait(false);
  }
}
