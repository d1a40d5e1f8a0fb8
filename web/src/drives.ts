// The list of the recorded drives of a studio's folder, which can be named and discarded.

import { add } from "./player";

export interface DriveRow {
  file: string;
  name: string;
  episode: number;
  seconds: number | null;
  outcome: string;
  by_person: number; // share of the steps
}

/** The panel with the recorded drives. */
export class DriveList {
  demonstrates = true; // whether drives of the robot become demonstrations
  private readonly place: HTMLElement;
  private readonly head: HTMLElement;

  constructor(
    private readonly panel: HTMLDetailsElement,
    private readonly request: (request: Record<string, unknown>) => void,
  ) {
    this.head = add(panel, "summary");
    this.place = add(panel, "div", "studio-drives");
    panel.hidden = true;
  }

  /** The rows as the studio has them. */
  show(rows: DriveRow[]): void {
    this.panel.hidden = false;
    this.head.textContent = `recorded drives: ${rows.length}`;
    this.place.textContent = "";
    if (!rows.length) {
      this.place.textContent = "record a drive; it is listed here when it has ended";
      return;
    }
    const table = add(this.place, "table");
    const top = add(add(table, "thead"), "tr");
    for (const text of ["drive", "name", "episode", "s", "outcome", "by a person", "demonstration", ""]) {
      add(top, "th").textContent = text;
    }
    const body = add(table, "tbody");
    for (const row of rows) this.addRow(add(body, "tr"), row);
  }

  private addRow(line: HTMLElement, row: DriveRow): void {
    const number = row.file.split(/[-.]/)[0];
    add(line, "td").textContent = number;
    const name = add(add(line, "td"), "input");
    name.value = row.name;
    name.maxLength = 60;
    name.setAttribute("aria-label", `name of drive ${number}`);
    name.addEventListener("change", () => this.request({ do: "rename", file: row.file, name: name.value }));
    const demonstrates = this.demonstrates && row.outcome === "completed" && row.by_person > 0;
    const texts = [
      String(row.episode),
      row.seconds === null ? "–" : row.seconds.toFixed(1),
      row.outcome,
      `${(100 * row.by_person).toFixed(0)} %`,
      demonstrates ? "yes" : "no",
    ];
    for (const text of texts) add(line, "td").textContent = text;
    const discard = add(add(line, "td"), "button");
    discard.textContent = "discard";
    discard.setAttribute("aria-label", `discard drive ${number}`);
    discard.title = "moves the file to trials/discarded, where it is no demonstration";
    discard.addEventListener("click", () => this.request({ do: "discard", file: row.file }));
  }
}
