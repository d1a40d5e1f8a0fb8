// What a sensor has in sight on the plan: rays against the boxes.

import type { Place, View } from "./recording";

const RAYS = 90;

/** The outline [m] of what is in sight from a place, as x, y, x, y, ... */
export function sight(place: Place, view: View, x: number, y: number, heading: number): number[] {
  const around = view.angle > 2 * Math.PI - 0.01;
  const points = around ? [] : [x, y];
  const near = place.obstacles.filter(
    ([cx, cy, hx, hy, , height]) => height > 0 && Math.hypot(cx - x, cy - y) - Math.hypot(hx, hy) < view.range,
  );
  for (let k = 0; k <= RAYS; k++) {
    const angle = heading + view.angle * (k / RAYS - 0.5);
    const [dx, dy] = [Math.cos(angle), Math.sin(angle)];
    let end = Math.min(view.range, toEdge(place.floor, x, y, dx, dy));
    for (const box of near) end = Math.min(end, toBox(box, x, y, dx, dy));
    points.push(x + end * dx, y + end * dy);
  }
  return points;
}

function toEdge(floor: Place["floor"], x: number, y: number, dx: number, dy: number): number {
  const alongX = dx > 0 ? (floor[2] - x) / dx : dx < 0 ? (floor[0] - x) / dx : Infinity;
  const alongY = dy > 0 ? (floor[3] - y) / dy : dy < 0 ? (floor[1] - y) / dy : Infinity;
  return Math.max(0, Math.min(alongX, alongY));
}

/** m along a ray from x, y to a box; infinite if it misses the box or begins inside. */
export function toBox([cx, cy, hx, hy, yaw]: number[], x: number, y: number, dx: number, dy: number): number {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  const [px, py] = [(x - cx) * c + (y - cy) * s, (y - cy) * c - (x - cx) * s];
  const [ux, uy] = [dx * c + dy * s, dy * c - dx * s];
  let [enter, leave] = [-Infinity, Infinity];
  for (const [p, u, half] of [
    [px, ux, hx],
    [py, uy, hy],
  ]) {
    if (Math.abs(u) < 1e-9) {
      if (Math.abs(p) > half) return Infinity;
      continue;
    }
    const [one, other] = [(-half - p) / u, (half - p) / u];
    enter = Math.max(enter, Math.min(one, other));
    leave = Math.min(leave, Math.max(one, other));
  }
  return leave < Math.max(enter, 0) || enter < 0 ? Infinity : enter;
}
