// Changes of an environment's files by mouse. A layer is what is changed: graph, sets, boxes, or a picture below them.

import { Backdrop } from "./backdrop";
import { Boxes } from "./edit_boxes";
import { GraphLayer } from "./edit_graph";
import { Sets } from "./edit_sets";
import type { Brush } from "./plan";
import { add, type Player } from "./player";
import type { Graph, Place, Recording } from "./recording";

const TREMOR = 3; // pixels, of a click

export type Pose = [number, number, number] | string; // m, m, degrees; or a group of the set

export interface SetOfPage {
  situation: string;
  starts: Pose[];
  goals: Pose[];
  loops: [number, number][][]; // m
  groups: Record<string, [number, number, number]>; // m: center, radius
}

/** What can be changed. */
export interface Edits {
  place: Place;
  graph: Graph | null;
  numbers: Record<"spawn" | "weight" | "capacity", number[]> & { stay: [number, number][] };
  sets: Record<string, SetOfPage> | null;
  set?: string; // of the episode
  boxes: Record<string, number[]> | null; // x, y, half sides, yaw, top; m and rad. null: of the package
  difference: string; // from the files
  changes: number; // that can be undone
}

/** A part of the files, or the picture below. */
export interface Layer {
  readonly name: string;
  readonly help: string;
  /** Whether the scenario has it. */
  has(edits: Edits): boolean;
  /** Take new values; a drag that was refused ends. */
  show(edits: Edits): void;
  /** The pointer is down at a place [m]; whether the layer takes it. */
  down(x: number, y: number, event: PointerEvent): boolean;
  move(x: number, y: number): void;
  up(x: number, y: number): void;
  draw: Brush;
  /** Numbers and buttons of what is selected. */
  fields(): void;
}

/** What layers do with the page. */
export class Desk {
  constructor(
    readonly player: Player,
    readonly recording: Recording,
    readonly panel: HTMLElement,
    private readonly send: (change: Record<string, unknown>, place: [number, number], note: string) => void,
    readonly refresh: () => void, // panel and plan
  ) {}

  /** Metres within which the pointer reaches a point. */
  get reach(): number {
    return 10 * this.player.pixel;
  }

  change(change: Record<string, unknown>, place: number[], note = "checking"): void {
    this.send(change, [place[0], place[1]], note);
  }

  title(text: string): void {
    add(this.panel, "strong").textContent = text;
  }

  field(name: string, value: number, act: (value: number) => void): void {
    const label = add(this.panel, "label");
    label.append(`${name} `);
    const input = add(label, "input");
    input.type = "number";
    input.step = "any";
    input.value = String(Number(value.toFixed(3)));
    input.addEventListener("change", () => act(Number(input.value)));
  }

  choice(name: string, value: string, options: string[], act: (value: string) => void): void {
    const label = add(this.panel, "label");
    label.append(`${name} `);
    const input = add(label, "select");
    for (const each of options) input.add(new Option(each.replace(/_/g, " "), each));
    input.value = value;
    input.addEventListener("change", () => act(input.value));
  }

  text(name: string, value: string, act: (value: string) => void): void {
    const label = add(this.panel, "label");
    label.append(`${name} `);
    const input = add(label, "input");
    input.value = value;
    input.addEventListener("input", () => act(input.value));
  }

  button(text: string, act: () => void, on = false): HTMLButtonElement {
    const made = add(this.panel, "button");
    made.textContent = text;
    made.classList.toggle("on", on);
    made.addEventListener("click", act);
    return made;
  }
}

export class Editor {
  private on = false;
  private edits: Edits | null = null;
  private pointer = -1; // that drags
  private from: [number, number] | null = null; // pixels, where it was down, until it has moved
  private place: [number, number] = [0, 0]; // m, of the latest change
  private layer: Layer;
  private readonly layers: Layer[];
  private readonly panel: HTMLElement;
  private readonly tabs: HTMLElement;
  private readonly help: HTMLElement;
  private readonly desk: Desk;
  private readonly bubble: HTMLElement;
  private readonly difference: HTMLElement;
  private readonly save: HTMLButtonElement;
  private readonly undo: HTMLButtonElement;

  constructor(
    place: HTMLElement,
    private readonly player: Player,
    private readonly recording: Recording,
    request: (request: Record<string, unknown>, note: string) => void,
  ) {
    this.panel = add(place, "section", "studio-edit");
    this.panel.hidden = true;
    this.tabs = add(this.panel, "div", "studio-bar");
    this.help = add(this.panel, "p");
    const send = (change: Record<string, unknown>, at: [number, number], note: string): void => {
      this.place = at;
      request({ do: "edit", change }, note);
    };
    this.desk = new Desk(player, recording, add(this.panel, "div", "studio-fields"), send, () => this.refresh());
    this.layers = [new GraphLayer(this.desk), new Sets(this.desk), new Boxes(this.desk), new Backdrop(this.desk)];
    this.layer = this.layers[0];
    const bar = add(this.panel, "div", "studio-bar");
    const button = (text: string): HTMLButtonElement => {
      const made = add(bar, "button");
      made.textContent = text;
      made.addEventListener("click", () => request({ do: text }, text === "undo" ? "checking" : "saving"));
      return made;
    };
    [this.undo, this.save] = [button("undo"), button("save")];
    this.difference = add(this.panel, "pre");
    this.difference.tabIndex = 0;
    const root = player.plan.parentElement!;
    this.bubble = add(root, "div", "studio-bubble");
    root.addEventListener("pointerdown", (event) => this.down(event), true);
    root.addEventListener("pointermove", (event) => this.move(event), true);
    for (const kind of ["pointerup", "pointercancel"] as const) root.addEventListener(kind, (event) => this.up(event), true);
    root.addEventListener("dblclick", (event) => this.on && event.stopPropagation(), true); // two clicks are two changes
  }

  /** Remove it from the page. */
  close(): void {
    this.on = false;
    this.panel.remove();
  }

  toggle(): boolean {
    this.on = !this.on;
    this.panel.hidden = !this.on;
    this.refresh();
    return this.on;
  }

  show(edits: Edits): void {
    this.edits = edits;
    this.bubble.textContent = "";
    this.difference.textContent = edits.difference;
    this.save.disabled = !edits.difference;
    this.undo.disabled = !edits.changes;
    this.recording.place = structuredClone(edits.place);
    for (const layer of this.layers) layer.show(structuredClone(edits));
    if (!this.layer.has(edits)) this.layer = this.layers.find((layer) => layer.has(edits))!;
    const root = this.panel.closest<HTMLElement>("[data-studio]")!;
    [root.dataset.difference, root.dataset.changes] = [edits.difference, String(edits.changes)];
    this.refresh();
  }

  /** What was dragged goes back to where it is: the studio has refused the change. */
  refuse(text: string): void {
    if (!this.edits || !this.on) return;
    this.show(this.edits);
    const node = /nodes\.([\w-]+)/.exec(text)?.[1];
    const index = node && this.edits.graph ? this.edits.graph.names.indexOf(node) : -1;
    const [x, y] = this.player.pixelOf(...(index < 0 ? this.place : (this.edits.graph!.position[index] as [number, number])));
    const { plan } = this.player;
    this.bubble.textContent = text;
    this.bubble.style.left = `${plan.offsetLeft + Math.max(0, Math.min(x - 20, plan.clientWidth - 260))}px`;
    this.bubble.style.top = `${plan.offsetTop + Math.max(0, y) + 14}px`;
  }

  private refresh(): void {
    const { layer, edits } = this;
    if (edits) {
      this.tabs.textContent = "";
      for (const each of this.layers.filter((each) => each.has(edits))) {
        const made = add(this.tabs, "button");
        made.textContent = each.name;
        made.classList.toggle("on", each === layer);
        made.setAttribute("aria-pressed", String(each === layer));
        made.addEventListener("click", () => {
          this.layer = each;
          this.bubble.textContent = "";
          this.refresh();
        });
      }
      this.help.textContent = layer.help;
      this.desk.panel.textContent = "";
      layer.fields();
    }
    const backdrop = this.layers[this.layers.length - 1];
    this.player.plan.parentElement!.classList.toggle("studio-quiet", this.on && layer !== this.layers[0]);
    if (this.on) this.player.drawMore(backdrop.draw, layer === backdrop ? undefined : layer.draw);
    else this.player.drawMore();
    this.player.redraw(this.on);
  }

  private down(event: PointerEvent): void {
    if (!this.on || !this.edits || event.target !== this.player.plan || event.button !== 0) return;
    this.bubble.textContent = "";
    if (!this.layer.down(...this.player.placeOf(event), event)) return;
    this.pointer = event.pointerId;
    this.from = [event.clientX, event.clientY];
    this.player.plan.setPointerCapture(event.pointerId);
    event.stopPropagation();
    this.refresh();
  }

  private move(event: PointerEvent): void {
    if (event.pointerId !== this.pointer) return;
    event.stopPropagation();
    if (this.from && Math.hypot(event.clientX - this.from[0], event.clientY - this.from[1]) < TREMOR) return;
    this.from = null;
    this.layer.move(...this.player.placeOf(event));
    this.player.redraw(true);
  }

  private up(event: PointerEvent): void {
    if (event.pointerId !== this.pointer) return;
    event.stopPropagation();
    this.pointer = -1;
    this.layer.up(...this.player.placeOf(event));
    this.refresh();
  }
}
