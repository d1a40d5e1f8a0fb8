// Obstacles of an own environment: boxes that are moved, turned and sized.

import type { Desk, Edits, Layer } from "./edit";
import type { Brush } from "./plan";

const BUILDING = "building the floor: this takes some seconds, then people begin anew";
const STALK = 28; // pixels, from a box to its handle for turns
const LEAST = 0.05; // m, of a side

export class Boxes implements Layer {
  readonly name = "obstacles";
  readonly help = "Drag a box. Its square handles change a side, the round one turns it.";
  private boxes: Record<string, number[]> = {}; // x, y, half sides, yaw, top
  private box = ""; // selected
  private drag: "box" | "turn" | number | null = null; // number: of a side
  private offset: [number, number] = [0, 0];
  private moved = false;
  private label: string | null = null; // of the box that the next click adds

  constructor(private readonly desk: Desk) {}

  has(edits: Edits): boolean {
    return edits.boxes !== null;
  }

  show(edits: Edits): void {
    this.boxes = edits.boxes ?? {};
    if (!(this.box in this.boxes)) this.box = "";
    this.drag = null;
  }

  /** A place in the axes of a box. */
  private local(box: number[], x: number, y: number): [number, number] {
    const [c, s] = [Math.cos(box[4]), Math.sin(box[4])];
    return [c * (x - box[0]) + s * (y - box[1]), c * (y - box[1]) - s * (x - box[0])];
  }

  private global(box: number[], u: number, v: number): [number, number] {
    const [c, s] = [Math.cos(box[4]), Math.sin(box[4])];
    return [box[0] + c * u - s * v, box[1] + s * u + c * v];
  }

  /** The handles of a box: four sides, and the turn. */
  private handles(box: number[]): [number, number][] {
    const [, , a, b] = box;
    const far = b + STALK * this.desk.player.pixel;
    return ([[a, 0], [0, b], [-a, 0], [0, -b], [0, far]] as const).map(([u, v]) => this.global(box, u, v));
  }

  down(x: number, y: number): boolean {
    this.moved = false;
    if (this.label !== null) {
      this.box = this.label;
      this.desk.change({ box: this.label, add: true, position: [x, y] }, [x, y], BUILDING);
      this.label = this.drag = null;
      return true;
    }
    const chosen = this.boxes[this.box];
    if (chosen) {
      const gaps = this.handles(chosen).map(([hx, hy]) => Math.hypot(hx - x, hy - y));
      const nearest = gaps.indexOf(Math.min(...gaps));
      const small = Math.hypot(...this.local(chosen, x, y)) < gaps[nearest]; // of a small box, the middle moves it
      if (gaps[nearest] < this.desk.reach && !small) {
        this.drag = nearest === 4 ? "turn" : nearest;
        return true;
      }
    }
    const inside = Object.entries(this.boxes).filter(([, box]) => {
      const [u, v] = this.local(box, x, y).map(Math.abs);
      return u < Math.max(box[2], this.desk.reach / 2) && v < Math.max(box[3], this.desk.reach / 2);
    });
    if (!inside.length) {
      if (this.box) [this.box, this.drag] = ["", null];
      this.desk.refresh();
      return false;
    }
    const area = ([, box]: [string, number[]]): number => box[2] * box[3];
    const [name, box] = inside.sort((one, other) => area(one) - area(other))[0];
    [this.box, this.drag, this.offset] = [name, "box", [box[0] - x, box[1] - y]];
    return true;
  }

  move(x: number, y: number): void {
    const box = this.boxes[this.box];
    if (!box || this.drag === null) return;
    this.moved = true;
    if (this.drag === "box") [box[0], box[1]] = [x + this.offset[0], y + this.offset[1]];
    else if (this.drag === "turn") {
      const degrees = Math.round((Math.atan2(y - box[1], x - box[0]) * 180) / Math.PI - 90);
      box[4] = (degrees * Math.PI) / 180;
    } else {
      const axis = this.drag % 2;
      const side = this.drag < 2 ? 1 : -1;
      const along = side * this.local(box, x, y)[axis]; // from the middle to the pointer; the other side stays
      const half = Math.max(LEAST / 2, (along + box[2 + axis]) / 2);
      const shift = side * (half - box[2 + axis]);
      [box[0], box[1]] = this.global(box, axis === 0 ? shift : 0, axis === 1 ? shift : 0);
      box[2 + axis] = half;
    }
  }

  up(): void {
    const box = this.boxes[this.box];
    if (box && this.moved) {
      const position = [box[0], box[1]];
      if (this.drag === "turn") this.change({ turn: degrees(box[4]) });
      else this.change(this.drag === "box" ? { position } : { position, size: [2 * box[2], 2 * box[3]] });
    }
    this.drag = null;
    this.moved = false;
  }

  private change(change: object): void {
    this.desk.change({ box: this.box, ...change }, this.boxes[this.box], BUILDING);
  }

  draw: Brush = (paint, camera, palette) => {
    for (const [name, box] of Object.entries(this.boxes)) {
      const chosen = name === this.box;
      paint.beginPath();
      for (const [u, v] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
        paint.lineTo(...camera.toScreen(...this.global(box, u * box[2], v * box[3])));
      }
      paint.closePath();
      [paint.lineWidth, paint.strokeStyle] = chosen ? [2, palette.robot] : [1, palette.muted];
      paint.stroke();
    }
    const box = this.boxes[this.box];
    if (!box) return;
    const handles = this.handles(box).map(([x, y]) => camera.toScreen(x, y));
    [paint.lineWidth, paint.strokeStyle, paint.fillStyle] = [2, palette.robot, palette.paper];
    paint.beginPath();
    paint.moveTo(...handles[1]);
    paint.lineTo(...handles[4]);
    paint.stroke();
    handles.forEach(([x, y], k) => {
      paint.beginPath();
      if (k < 4) paint.rect(x - 4, y - 4, 8, 8);
      else paint.arc(x, y, 5, 0, 2 * Math.PI);
      paint.fill();
      paint.stroke();
    });
  };

  fields(): void {
    const { desk } = this;
    if (this.label !== null) {
      desk.title("Click the place of the new box.");
      desk.text("name", this.label, (label) => (this.label = label));
      desk.button("no box", () => {
        this.label = null;
        desk.refresh();
      });
      return;
    }
    const box = this.boxes[this.box];
    if (box) {
      desk.title(this.box);
      desk.field("length, m", 2 * box[2], (side) => this.change({ size: [side, 2 * box[3]] }));
      desk.field("width, m", 2 * box[3], (side) => this.change({ size: [2 * box[2], side] }));
      desk.field("height, m", box[5], (height) => this.change({ height }));
      desk.field("turn, °", degrees(box[4]), (turn) => this.change({ turn }));
      desk.button("remove box", () => this.change({ remove: true }));
    }
    desk.button("add box", () => {
      let number = 1;
      while (`box_${number}` in this.boxes) number++;
      this.label = `box_${number}`;
      desk.refresh();
    });
  }
}

function degrees(angle: number): number {
  return Number(((angle * 180) / Math.PI).toFixed(2));
}
