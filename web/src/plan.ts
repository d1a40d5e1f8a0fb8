// The plan view: floor, obstacles, graph, trails, people, groups, robot.

import type { Camera } from "./camera";
import type { Episode, Place, Recording, View } from "./recording";
import { sight } from "./sight";
import type { Palette } from "./palette";
import { stateOf } from "./state";

/** Draws more on the plan. */
export type Brush = (paint: CanvasRenderingContext2D, camera: Camera, palette: Palette) => void;

export interface Shown {
  trails: boolean;
  graph: boolean;
  sight: boolean;
  person: number; // whose whole way is drawn, -1 none
  under?: Brush; // on the floor, below all else
  over?: Brush; // above all else
}

const SCALES = [0.5, 1, 2, 5, 10, 20, 50]; // m
export const TRAIL = 3; // s, of people
const SHOULDERS = 0.23; // m, half of the width of a person; depth is that of the body
const HEADS = 24; // pixels in a metre, from which on people have heads; darts below
const STATES = ["person", "member", "yielding"] as const;

/** The obstacles of a place; higher ones are darker. */
export function drawObstacles(paint: CanvasRenderingContext2D, camera: Camera, palette: Palette, place: Place): void {
  for (const [cx, cy, hx, hy, yaw, height] of place.obstacles) {
    if (height <= 0) continue;
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    paint.beginPath();
    for (const [a, b] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
      paint.lineTo(...camera.toScreen(cx + c * a * hx - s * b * hy, cy + s * a * hx + c * b * hy));
    }
    paint.closePath();
    paint.globalAlpha = 0.25 + 0.45 * Math.min(1, height / 4) ** 0.7;
    paint.fillStyle = palette.obstacle;
    paint.fill();
    [paint.lineWidth, paint.strokeStyle] = [1, palette.obstacle];
    paint.stroke();
    paint.globalAlpha = 1;
  }
}

export function drawPlan(
  paint: CanvasRenderingContext2D,
  camera: Camera,
  palette: Palette,
  recording: Recording,
  episode: Episode,
  time: number,
  shown: Shown,
): void {
  const metre = camera.scale;
  const frame = episode.frameAt(time);
  const robot = recording.robot;
  const [rx, ry] = robot ? ["robot x", "robot y"].map((name) => episode.at(episode.of(name)[0], time)) : [0, 0];
  const heading = robot ? episode.angleAt(episode.of("robot heading")[0], time) : 0;

  const line = (width: number, color: string): void => {
    [paint.lineWidth, paint.strokeStyle] = [width, color];
    paint.stroke();
  };
  const disc = (x: number, y: number, radius: number): void => {
    paint.beginPath();
    paint.arc(...camera.toScreen(x, y), radius, 0, 2 * Math.PI);
  };
  const outline = (points: number[]): void => {
    paint.beginPath();
    for (let k = 0; k < points.length; k += 2) paint.lineTo(...camera.toScreen(points[k], points[k + 1]));
  };

  const [x0, y0, x1, y1] = recording.place.floor;
  outline([x0, y0, x1, y0, x1, y1, x0, y1]);
  paint.closePath();
  paint.fillStyle = palette.floor;
  paint.fill();
  line(1, palette.line);
  shown.under?.(paint, camera, palette);
  if (robot && shown.sight) drawSight(robot.views);
  if (shown.graph && recording.graph) drawGraph();
  drawObstacles(paint, camera, palette, recording.place);
  drawGroups();
  if (shown.trails) drawTrails();
  if (robot) drawPath();
  drawPeople();
  if (robot) {
    const [xs, ys, angles] = ["other x", "other y", "other heading"].map((name) => episode.of(name));
    xs.forEach((x, k) => {
      drawRobot(robot.others?.[k] ?? robot.radius, episode.at(x, time), episode.at(ys[k], time), episode.angleAt(angles[k], time));
    });
    drawRobot(robot.radius, rx, ry, heading);
  }
  shown.over?.(paint, camera, palette);
  drawScale();

  function drawScale(): void {
    const length = SCALES.find((each) => each * metre > 60) ?? 100;
    const [left, bottom] = [10, paint.canvas.clientHeight - 10];
    paint.globalAlpha = 0.85; // walls below it do not hide it
    paint.fillStyle = palette.paper;
    paint.fillRect(left - 6, bottom - 22, Math.max(length * metre, 34) + 12, 28);
    paint.globalAlpha = 1;
    paint.beginPath();
    paint.moveTo(left, bottom - 5);
    paint.lineTo(left, bottom);
    paint.lineTo(left + length * metre, bottom);
    paint.lineTo(left + length * metre, bottom - 5);
    line(1.5, palette.muted);
    paint.font = "12px system-ui, sans-serif";
    paint.textBaseline = "alphabetic";
    [paint.lineWidth, paint.strokeStyle, paint.fillStyle] = [3, palette.paper, palette.muted];
    paint.strokeText(`${length} m`, left + 6, bottom - 5);
    paint.fillText(`${length} m`, left + 6, bottom - 5);
  }

  function drawGraph(): void {
    const graph = recording.graph!;
    for (const [from, to, flow] of graph.edges) {
      const [a, b] = [graph.position[from], graph.position[to]];
      outline([...a, ...b]);
      paint.setLineDash(flow === "low" ? [2, 4] : []);
      line(flow === "high" ? 3 : 1.4, palette.faint);
      paint.setLineDash([]);
      if (flow === "forward" || flow === "backward") arrow(flow === "forward" ? a : b, flow === "forward" ? b : a);
    }
    graph.position.forEach(([x, y], node) => {
      disc(x, y, graph.radius[node] * metre);
      paint.setLineDash(graph.group[node] ? [4, 3] : []);
      line(1.2, graph.group[node] ? palette.member : palette.faint);
      paint.setLineDash([]);
    });
  }

  function arrow(from: number[], to: number[]): void {
    const [ax, ay] = camera.toScreen(from[0], from[1]);
    const [bx, by] = camera.toScreen(to[0], to[1]);
    const [mx, my, angle] = [(ax + bx) / 2, (ay + by) / 2, Math.atan2(by - ay, bx - ax)];
    paint.beginPath();
    for (const turn of [0, 2.6, -2.6]) paint.lineTo(mx + 6 * Math.cos(angle + turn), my + 6 * Math.sin(angle + turn));
    paint.closePath();
    paint.fillStyle = palette.faint;
    paint.fill();
  }

  function drawSight(views: View[]): void {
    for (const view of views) {
      outline(sight(recording.place, view, rx, ry, heading));
      paint.closePath();
      paint.globalAlpha = 0.16;
      paint.fillStyle = palette.robot;
      paint.fill();
      paint.globalAlpha = 1;
    }
  }

  function drawGroups(): void {
    const members = new Map<number, [number, number][]>();
    episode.of("person group").forEach((group, n) => {
      if (group[frame] < 0 || !present(n, frame)) return;
      const place: [number, number] = [here("person x", n), here("person y", n)];
      members.set(group[frame], [...(members.get(group[frame]) ?? []), place]);
    });
    for (const places of members.values()) {
      if (places.length < 2) continue;
      const x = places.reduce((sum, place) => sum + place[0], 0) / places.length;
      const y = places.reduce((sum, place) => sum + place[1], 0) / places.length;
      const reach = Math.max(...places.map((place) => Math.hypot(place[0] - x, place[1] - y)));
      if (reach > 3) continue; // on their way there
      disc(x, y, reach * metre);
      paint.globalAlpha = 0.14;
      paint.fillStyle = palette.member;
      paint.fill();
      paint.globalAlpha = 1;
      paint.setLineDash([3, 3]);
      line(1, palette.member);
      paint.setLineDash([]);
    }
  }

  function present(n: number, t: number): boolean {
    return episode.of("person present")[n][t] > 0.5;
  }

  function here(name: string, n: number): number {
    const column = episode.of(name)[n];
    const stays = present(n, Math.min(frame + 1, episode.frames - 1));
    return stays ? episode.at(column, time) : column[frame];
  }

  function drawTrails(): void {
    const first = episode.frameAt(time - TRAIL);
    const [xs, ys] = [episode.of("person x"), episode.of("person y")];
    paint.beginPath();
    for (let n = 0; n < xs.length; n++) {
      let down = false;
      for (let t = first; t <= frame; t += 2) {
        if (!present(n, t)) {
          down = false;
          continue;
        }
        if (t > first && !present(n, t - 1)) down = false; // left and came in elsewhere
        const point = camera.toScreen(xs[n][t], ys[n][t]);
        if (down) paint.lineTo(...point);
        else paint.moveTo(...point);
        down = true;
      }
      if (down) paint.lineTo(...camera.toScreen(here("person x", n), here("person y", n)));
    }
    paint.globalAlpha = 0.7;
    line(Math.min(4, Math.max(1, 0.07 * metre)), palette.trail);
    paint.globalAlpha = 1;
  }

  function drawPath(): void {
    const [xs, ys] = [episode.of("robot x")[0], episode.of("robot y")[0]];
    disc(xs[0], ys[0], Math.max(5, 0.3 * metre));
    line(2, palette.robot);
    const goals = ["", "other "].flatMap((whose) => {
      const [x, y] = ["x", "y"].map((axis) => episode.of(`${whose}goal ${axis}`));
      return x.map((column, k) => [column[frame], y[k][frame]]);
    });
    goals.forEach(([gx, gy], k) => {
      disc(gx, gy, Math.max(8, 0.5 * metre));
      paint.setLineDash(k ? [4, 3] : []); // of the other robots of a team
      line(2, palette.robot);
      paint.setLineDash([]);
      disc(gx, gy, Math.max(3, 0.16 * metre));
      paint.fillStyle = palette.robot;
      paint.fill();
    });
    const plan = episode.of("plan x").map((column, k) => [column[frame], episode.of("plan y")[k][frame]]);
    if (plan.length) {
      outline([rx, ry, ...plan.flat()]);
      paint.setLineDash([5, 5]);
      line(1.5, palette.robot);
      paint.setLineDash([]);
    }
    const flags = episode.of("situation");
    const color = (t: number): string => {
      const first = flags.findIndex((flag) => flag[t] > 0.5);
      return first < 0 ? palette.none : recording.situations[first].color;
    };
    for (let t = 0; t < frame; ) {
      const shade = color(t + 1);
      paint.beginPath();
      paint.moveTo(...camera.toScreen(xs[t], ys[t]));
      do {
        t++;
        paint.lineTo(...camera.toScreen(xs[t], ys[t]));
      } while (t < frame && color(t + 1) === shade);
      line(Math.min(6, Math.max(2, 0.1 * metre)), shade);
    }
  }

  function drawPeople(): void {
    if (shown.person >= 0) drawPerson(shown.person);
    const crowd: Record<(typeof STATES)[number], [number, number, number][]> = { person: [], member: [], yielding: [] };
    for (let n = 0; n < episode.of("person x").length; n++) {
      if (!present(n, frame)) continue;
      const angle = -episode.angleAt(episode.of("person heading")[n], time);
      crowd[stateOf(episode, n, frame)].push([...camera.toScreen(here("person x", n), here("person y", n)), angle]);
    }
    for (const state of STATES) {
      paint.fillStyle = palette[state];
      for (const [x, y, angle] of crowd[state]) {
        paint.beginPath(); // one each: a path of all takes twice as long to fill
        (metre < HEADS ? dart : shoulders)(x, y, angle);
        paint.fill();
        if (metre >= HEADS) line(1, palette.ink);
      }
    }
    if (metre < HEADS) return;
    paint.beginPath(); // heads, a little ahead of the shoulders, with noses
    for (const [x, y, angle] of Object.values(crowd).flat()) {
      const [c, s] = [Math.cos(angle) * metre, Math.sin(angle) * metre];
      paint.moveTo(x + 0.21 * c, y + 0.21 * s);
      paint.lineTo(x + 0.09 * s, y - 0.09 * c);
      paint.arc(x + 0.03 * c, y + 0.03 * s, 0.1 * metre, angle - Math.PI / 2, angle + Math.PI / 2, true);
      paint.closePath();
    }
    paint.fillStyle = palette.paper;
    paint.fill();
    line(1, palette.ink);
  }

  function dart(x: number, y: number, angle: number): void {
    const size = Math.max(6, 0.36 * metre);
    const [c, s] = [size * Math.cos(angle), size * Math.sin(angle)];
    paint.moveTo(x + 1.1 * c, y + 1.1 * s);
    paint.lineTo(x - 0.8 * c - 0.7 * s, y - 0.8 * s + 0.7 * c);
    paint.lineTo(x - 0.4 * c, y - 0.4 * s);
    paint.lineTo(x - 0.8 * c + 0.7 * s, y - 0.8 * s - 0.7 * c);
    paint.closePath();
  }

  function shoulders(x: number, y: number, angle: number): void {
    const depth = 0.7 * recording.person.radius * metre;
    paint.moveTo(x + depth * Math.cos(angle), y + depth * Math.sin(angle));
    paint.ellipse(x, y, depth, SHOULDERS * metre, angle, 0, 2 * Math.PI);
  }

  /** The way of a person so far, and a ring. */
  function drawPerson(n: number): void {
    const [xs, ys] = [episode.of("person x")[n], episode.of("person y")[n]];
    paint.beginPath();
    for (let t = 0; t <= frame; t++) {
      if (!present(n, t)) continue;
      const point = camera.toScreen(xs[t], ys[t]);
      if (t > 0 && present(n, t - 1)) paint.lineTo(...point);
      else paint.moveTo(...point);
    }
    if (present(n, frame)) paint.lineTo(...camera.toScreen(here("person x", n), here("person y", n)));
    line(2, palette.ink);
    if (!present(n, frame)) return;
    disc(here("person x", n), here("person y", n), Math.max(10, 0.45 * metre));
    line(2, palette.ink);
  }

  function drawRobot(body: number, x: number, y: number, heading: number): void {
    disc(x, y, Math.max(15, 1.8 * body * metre)); // a halo, so that it is found at its true size
    paint.globalAlpha = 0.25;
    paint.fillStyle = palette.robot;
    paint.fill();
    paint.globalAlpha = 1;
    const radius = Math.max(4, body * metre);
    disc(x, y, radius);
    paint.fillStyle = palette.robot;
    paint.fill();
    line(1.5, palette["robot-edge"]);
    const [px, py] = camera.toScreen(x, y);
    paint.beginPath();
    paint.moveTo(px, py);
    paint.lineTo(px + 1.7 * radius * Math.cos(heading), py - 1.7 * radius * Math.sin(heading));
    line(2, palette["robot-edge"]);
  }
}
