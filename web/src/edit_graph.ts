// The Behavior Graph: nodes and edges by mouse, numbers of the node that is selected.

import type { Desk, Edits, Layer } from "./edit";
import type { Brush } from "./plan";
import type { Graph } from "./recording";

const FLOWS = ["medium", "high", "low", "forward", "backward"];
const ANEW = "building: people begin anew";

export class GraphLayer implements Layer {
  readonly name = "graph";
  readonly help =
    "Drag a node. Drag from its rim to another node for an edge. Click an edge for its next flow. Click a node for its numbers.";
  private graph: Graph | null = null;
  private numbers: Edits["numbers"] | null = null;
  private node = -1; // selected
  private edge: [number, number] | null = null; // selected
  private kind: "waypoint" | "group" | null = null; // of the node that the next click adds
  private label = "";
  private drag: "node" | "edge" | null = null;
  private pointer: [number, number] | null = null; // m, of a drag

  constructor(private readonly desk: Desk) {}

  has(edits: Edits): boolean {
    return edits.graph !== null;
  }

  show(edits: Edits): void {
    const name = this.graph?.names[this.node];
    [this.graph, this.numbers] = [edits.graph, edits.numbers];
    this.desk.recording.graph = this.graph;
    this.node = name ? (this.graph?.names.indexOf(name) ?? -1) : -1;
    this.edge = this.edge && this.graph?.edges.some(([a, b]) => a === this.edge![0] && b === this.edge![1]) ? this.edge : null;
    this.drag = this.pointer = null;
  }

  down(x: number, y: number, event: PointerEvent): boolean {
    const graph = this.graph!;
    const { position, names, radius } = graph;
    const gaps = position.map(([nx, ny]) => Math.hypot(nx - x, ny - y));
    const nearest = gaps.indexOf(Math.min(...gaps));
    this.pointer = null;
    if (this.kind) {
      const edge = names[this.node >= 0 ? this.node : nearest];
      this.desk.change({ node: this.label, add: this.kind, position: [x, y], edge }, [x, y], ANEW);
      this.kind = null;
      return true;
    }
    if (gaps[nearest] < Math.max(this.desk.reach, 0.3)) {
      if (event.shiftKey && this.node >= 0 && this.node !== nearest) this.connect(this.node, nearest);
      else this.drag = "node";
      [this.node, this.edge] = [nearest, null];
      return true;
    }
    const rim = gaps.findIndex((gap, k) => Math.abs(gap - radius[k]) < this.desk.reach);
    if (rim >= 0) {
      [this.node, this.edge, this.drag] = [rim, null, "edge"];
      return true;
    }
    const found = graph.edges.find(([a, b]) => toSegment(x, y, position[a], position[b]) < this.desk.reach);
    if (!found) return false;
    const [a, b, flow] = found;
    [this.node, this.edge] = [-1, [a, b]];
    const next = FLOWS[(FLOWS.indexOf(flow) + 1) % FLOWS.length];
    this.desk.change({ edge: [names[a], names[b]], flow: next }, [x, y]);
    return true;
  }

  move(x: number, y: number): void {
    this.pointer = [x, y];
    if (this.drag === "node") this.graph!.position[this.node] = [x, y];
  }

  up(x: number, y: number): void {
    const { drag, node } = this;
    const { names, position, radius } = this.graph!;
    if (drag === "node" && this.pointer) this.desk.change({ node: names[node], position: position[node] }, [x, y]);
    if (drag === "edge" && this.pointer) {
      const reach = Math.max(this.desk.reach, 0.3);
      const gaps = position.map(([nx, ny], k) => (k === node ? Infinity : Math.hypot(nx - x, ny - y) - Math.max(reach, radius[k])));
      const nearest = gaps.indexOf(Math.min(...gaps));
      if (gaps[nearest] <= 0) this.connect(node, nearest);
    }
    this.drag = this.pointer = null;
  }

  private connect(a: number, b: number): void {
    const { names, edges, position } = this.graph!;
    this.edge = [Math.min(a, b), Math.max(a, b)];
    if (edges.some(([u, v]) => u === this.edge![0] && v === this.edge![1])) return;
    this.desk.change({ edge: [names[a], names[b]], flow: "medium" }, position[b]);
  }

  draw: Brush = (paint, camera, palette) => {
    const graph = this.graph!;
    const size = camera.scale;
    paint.strokeStyle = palette.robot;
    paint.lineWidth = 2;
    graph.position.forEach(([x, y], k) => {
      paint.beginPath();
      paint.arc(...camera.toScreen(x, y), 4, 0, 2 * Math.PI);
      paint.fillStyle = k === this.node ? palette.robot : palette.faint;
      paint.fill();
      if (k !== this.node) return;
      paint.beginPath();
      paint.arc(...camera.toScreen(x, y), graph.radius[k] * size, 0, 2 * Math.PI);
      paint.stroke();
    });
    const ends = this.edge?.map((k) => graph.position[k]) ?? (this.drag === "edge" && this.pointer ? [graph.position[this.node], this.pointer] : []);
    paint.beginPath();
    for (const [x, y] of ends) paint.lineTo(...camera.toScreen(x, y));
    paint.stroke();
  };

  fields(): void {
    const { desk, numbers, graph } = this;
    if (!graph || !numbers) return;
    if (this.kind) {
      desk.title("Click the place of the new node.");
      desk.text("name", this.label, (label) => (this.label = label));
      desk.choice("kind", this.kind, ["waypoint", "group"], (kind) => (this.kind = kind as "waypoint" | "group"));
      const to = graph.names[this.node];
      desk.title(to ? `It gets an edge to ${to}.` : "It gets an edge to the nearest node.");
      desk.button("no node", () => {
        this.kind = null;
        desk.refresh();
      });
      return;
    }
    if (this.edge) {
      const [a, b] = this.edge.map((k) => graph.names[k]);
      desk.title(`${a} – ${b}`);
      desk.button("remove edge", () => desk.change({ edge: [a, b], flow: null }, graph.position[this.edge![0]]));
    }
    if (this.node >= 0) this.numbersOf(this.node);
    desk.button("add node", () => {
      let number = graph.names.length;
      while (graph.names.includes(`node_${number}`)) number++;
      [this.kind, this.label] = ["waypoint", `node_${number}`];
      desk.refresh();
    });
  }

  private numbersOf(k: number): void {
    const { desk } = this;
    const [graph, numbers] = [this.graph!, this.numbers!];
    const [name, place] = [graph.names[k], graph.position[k]];
    desk.title(name);
    const field = (text: string, value: number, change: (value: number) => object, note?: string): void =>
      desk.field(text, value, (value) => desk.change({ node: name, ...change(value) }, place, note));
    field("radius, m", graph.radius[k], (radius) => ({ radius }));
    field("spawn", numbers.spawn[k], (spawn) => ({ spawn }));
    if (graph.group[k]) {
      const [least, most] = numbers.stay[k];
      field("capacity", numbers.capacity[k], (capacity) => ({ capacity }), ANEW);
      field("shortest stay, s", least, (value) => ({ stay: [value, most] }));
      field("longest stay, s", most, (value) => ({ stay: [least, value] }));
    } else field("weight", numbers.weight[k], (weight) => ({ weight }));
    desk.button("remove node", () => desk.change({ node: name, remove: true }, place, ANEW));
  }
}

/** The distance of a place from a line between two others. */
export function toSegment(x: number, y: number, a: number[], b: number[]): number {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const share = Math.max(0, Math.min(1, ((x - a[0]) * dx + (y - a[1]) * dy) / Math.max(1e-9, dx * dx + dy * dy)));
  return Math.hypot(x - a[0] - share * dx, y - a[1] - share * dy);
}
