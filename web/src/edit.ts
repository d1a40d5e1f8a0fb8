// Changes of the Behavior Graph by mouse: drag a node, click an edge, numbers of the node that is selected.

import { add, type Player } from "./player";
import type { Graph } from "./recording";

export interface GraphNews {
  graph: Graph;
  numbers: Record<"spawn" | "weight" | "capacity", number[]> & { stay: [number, number][] };
  difference: string; // from the file
}

const FLOWS = ["medium", "high", "low", "forward", "backward"];
const NEAR = 10; // pixels, from an edge or the middle of a node

export class Editor {
  private on = false;
  private news: GraphNews | null = null;
  private node = -1; // selected
  private dragged = false;
  private readonly panel: HTMLElement;
  private readonly fields: HTMLElement;
  private readonly difference: HTMLElement;
  private readonly save: HTMLButtonElement;
  private readonly undo: HTMLButtonElement;

  constructor(
    place: HTMLElement,
    private readonly player: Player,
    private readonly graph: () => Graph,
    private readonly request: (request: Record<string, unknown>) => void,
  ) {
    this.panel = add(place, "section", "studio-edit");
    this.panel.hidden = true;
    add(this.panel, "p").textContent = "Drag a node. Click an edge for its next flow. Click a node for its numbers.";
    this.fields = add(this.panel, "div", "studio-fields");
    const bar = add(this.panel, "div", "studio-bar");
    this.undo = this.button(bar, "undo", () => request({ do: "undo" }));
    this.save = this.button(bar, "save", () => request({ do: "save" }));
    this.difference = add(this.panel, "pre");
    this.difference.tabIndex = 0;
    const root = player.plan.parentElement!;
    root.addEventListener("pointerdown", (event) => this.down(event), true);
    root.addEventListener("pointermove", (event) => this.move(event), true);
    root.addEventListener("pointerup", (event) => this.up(event), true);
  }

  private button(place: HTMLElement, text: string, act: () => void): HTMLButtonElement {
    const made = add(place, "button");
    made.textContent = text;
    made.addEventListener("click", act);
    return made;
  }

  /** Remove it from the page. */
  close(): void {
    this.on = false;
    this.panel.remove();
  }

  toggle(): boolean {
    this.on = !this.on;
    this.panel.hidden = !this.on;
    this.player.redraw(this.on);
    return this.on;
  }

  show(news: GraphNews): void {
    this.news = news;
    this.difference.textContent = news.difference;
    this.undo.disabled = this.save.disabled = !news.difference;
    this.numbers();
    this.player.redraw(this.on);
  }

  /** What was dragged goes back to where it is: the studio has refused the change. */
  refuse(): void {
    if (this.news) this.graph().position = this.news.graph.position.map((place) => [...place]);
    this.player.redraw(this.on);
  }

  private down(event: PointerEvent): void {
    if (!this.on || event.target !== this.player.plan) return;
    const [x, y] = this.player.placeOf(event);
    const { position } = this.graph();
    const reach = NEAR * this.player.pixel;
    const gaps = position.map(([nx, ny]) => Math.hypot(nx - x, ny - y));
    const nearest = gaps.indexOf(Math.min(...gaps));
    if (gaps[nearest] < Math.max(reach, 0.3)) {
      this.node = nearest;
      this.dragged = false;
      this.numbers();
      (event.target as Element).setPointerCapture(event.pointerId);
      event.stopPropagation();
      return;
    }
    const edge = this.graph().edges.findIndex(([a, b]) => toSegment(x, y, position[a], position[b]) < reach);
    if (edge < 0) return;
    event.stopPropagation();
    const [a, b, flow] = this.graph().edges[edge];
    const next = FLOWS[(FLOWS.indexOf(flow) + 1) % FLOWS.length];
    const { names } = this.graph();
    this.request({ do: "edit", change: { edge: [names[a], names[b]], flow: next } });
  }

  private move(event: PointerEvent): void {
    if (!this.on || this.node < 0 || event.buttons === 0 || event.target !== this.player.plan) return;
    event.stopPropagation();
    this.dragged = true;
    this.graph().position[this.node] = this.player.placeOf(event);
    this.player.redraw(true);
  }

  private up(event: PointerEvent): void {
    if (!this.on || this.node < 0 || !this.dragged) return;
    event.stopPropagation();
    this.dragged = false;
    this.request({ do: "edit", change: { node: this.name, position: this.graph().position[this.node] } });
  }

  private get name(): string {
    return this.graph().names[this.node];
  }

  private numbers(): void {
    this.fields.textContent = "";
    if (this.node < 0 || !this.news) return;
    const { numbers, graph } = this.news;
    const k = this.node;
    add(this.fields, "strong").textContent = this.name;
    const field = (key: string, value: number, change: (value: number) => unknown): void => {
      const label = add(this.fields, "label");
      label.append(`${key} `);
      const input = add(label, "input");
      input.type = "number";
      input.step = "any";
      input.value = String(value);
      input.addEventListener("change", () => this.request({ do: "edit", change: { node: this.name, ...(change(Number(input.value)) as object) } }));
    };
    field("radius, m", graph.radius[k], (radius) => ({ radius }));
    field("spawn", numbers.spawn[k], (spawn) => ({ spawn }));
    if (!graph.group[k]) {
      field("weight", numbers.weight[k], (weight) => ({ weight }));
      return;
    }
    const [least, most] = numbers.stay[k];
    field("capacity", numbers.capacity[k], (capacity) => ({ capacity }));
    field("shortest stay, s", least, (value) => ({ stay: [value, most] }));
    field("longest stay, s", most, (value) => ({ stay: [least, value] }));
  }
}

function toSegment(x: number, y: number, a: number[], b: number[]): number {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const share = Math.max(0, Math.min(1, ((x - a[0]) * dx + (y - a[1]) * dy) / Math.max(1e-9, dx * dx + dy * dy)));
  return Math.hypot(x - a[0] - share * dx, y - a[1] - share * dy);
}
