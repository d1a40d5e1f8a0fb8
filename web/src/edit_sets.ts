// Handcrafted sets: starts, goals, loops and groups by mouse.

import type { Desk, Edits, Layer, SetOfPage } from "./edit";
import type { Brush } from "./plan";

type Keys = (string | number)[]; // of a point in its set

export class Sets implements Layer {
  readonly name = "sets";
  readonly help =
    "Drag a start (circle), a goal (disc), a place of a loop or the center of a group. Places that sets share move together.";
  private sets: Record<string, SetOfPage> = {};
  private label = "";
  private point: Keys | null = null; // selected
  private dragged = false;

  constructor(private readonly desk: Desk) {}

  has(edits: Edits): boolean {
    return edits.sets !== null;
  }

  show(edits: Edits): void {
    this.sets = edits.sets ?? {};
    if (!(this.label in this.sets)) [this.label, this.point] = [edits.set ?? "", null];
    this.dragged = false;
  }

  private get set(): SetOfPage {
    return this.sets[this.label];
  }

  /** The points of the set, and their keys in the file. */
  private points(): [Keys, number[]][] {
    const points: [Keys, number[]][] = [];
    for (const key of ["starts", "goals"] as const) {
      this.set[key].forEach((pose, k) => typeof pose !== "string" && points.push([[key, k], pose]));
    }
    this.set.loops.forEach((loop, w) => loop.forEach((place, k) => points.push([["walkers", w, "loop", k], place])));
    for (const [name, group] of Object.entries(this.set.groups)) points.push([["groups", name, "center"], group]);
    return points;
  }

  private get selected(): number[] | null {
    return this.points().find(([keys]) => String(keys) === String(this.point))?.[1] ?? null;
  }

  down(x: number, y: number): boolean {
    const gaps = this.points().map(([, place]) => Math.hypot(place[0] - x, place[1] - y));
    const nearest = gaps.indexOf(Math.min(...gaps));
    if (!(gaps[nearest] < this.desk.reach)) return false;
    [this.point, this.dragged] = [this.points()[nearest][0], false];
    return true;
  }

  move(x: number, y: number): void {
    const place = this.selected;
    if (place) [place[0], place[1], this.dragged] = [x, y, true];
  }

  up(x: number, y: number): void {
    if (this.dragged) this.desk.change({ set: this.label, point: this.point, position: [x, y] }, [x, y]);
    this.dragged = false;
  }

  draw: Brush = (paint, camera, palette) => {
    if (!this.set) return;
    const disc = (place: number[], radius: number): void => {
      paint.beginPath();
      paint.arc(...camera.toScreen(place[0], place[1]), radius, 0, 2 * Math.PI);
    };
    for (const loop of this.set.loops) {
      paint.beginPath();
      for (const [x, y] of loop) paint.lineTo(...camera.toScreen(x, y));
      paint.closePath();
      [paint.lineWidth, paint.strokeStyle, paint.fillStyle] = [1.5, palette.ink, palette.ink];
      paint.stroke();
      for (const place of loop) {
        disc(place, 5);
        paint.fill();
      }
    }
    for (const group of Object.values(this.set.groups)) {
      [paint.lineWidth, paint.strokeStyle, paint.fillStyle] = [2, palette.member, palette.member];
      disc(group, group[2] * camera.scale);
      paint.setLineDash([5, 4]);
      paint.stroke();
      paint.setLineDash([]);
      disc(group, 5);
      paint.fill();
    }
    [paint.lineWidth, paint.strokeStyle] = [2, palette.robot];
    for (const key of ["starts", "goals"] as const) {
      for (const pose of this.set[key]) {
        if (typeof pose === "string") continue;
        const [px, py] = camera.toScreen(pose[0], pose[1]);
        const angle = (-pose[2] * Math.PI) / 180;
        paint.beginPath();
        paint.moveTo(px, py);
        paint.lineTo(px + 14 * Math.cos(angle), py + 14 * Math.sin(angle));
        paint.stroke();
        disc(pose, 6);
        paint.fillStyle = key === "goals" ? palette.robot : palette.paper;
        paint.fill();
        paint.stroke();
      }
    }
    const place = this.selected;
    if (!place) return;
    disc(place, 10);
    paint.strokeStyle = palette.ink;
    paint.stroke();
  };

  fields(): void {
    const { desk } = this;
    desk.choice("set", this.label, Object.keys(this.sets), (label) => {
      [this.label, this.point] = [label, null];
      desk.refresh();
    });
    const place = this.selected;
    if (!place || !this.point) return;
    const [key, index] = this.point;
    desk.title(key === "walkers" ? `place ${this.point[3]} of loop ${index}` : key === "groups" ? `group ${index}` : `${String(key).slice(0, -1)} ${index}`);
    if (key !== "starts" && key !== "goals") return;
    desk.field("heading, °", place[2], (heading) => desk.change({ set: this.label, point: this.point, heading }, place));
  }
}
