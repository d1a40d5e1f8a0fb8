// What lies at a place of the plan, in words.

import type { Episode, Recording } from "./recording";

const REACH = 0.35; // m, around people and the robot

/** The robot, a person, a node or an obstacle at a place [m]; nothing elsewhere. */
export function pick(recording: Recording, episode: Episode, time: number, graph: boolean, x: number, y: number): string {
  const frame = episode.frameAt(time);
  const at = (name: string, k = 0): number => episode.at(episode.of(name)[k], time);
  const robot = recording.robot;
  if (robot && Math.hypot(at("robot x") - x, at("robot y") - y) < Math.max(REACH, robot.radius)) {
    const [speed, goal] = [at("speed"), at("distance to goal")];
    return `${robot.name}: ${speed.toFixed(2)} m/s, ${goal.toFixed(1)} m to its goal`;
  }
  let [nearest, gap] = [-1, REACH];
  episode.of("person present").forEach((flag, n) => {
    const away = flag[frame] > 0.5 ? Math.hypot(at("person x", n) - x, at("person y", n) - y) : Infinity;
    if (away < gap) [nearest, gap] = [n, away];
  });
  if (nearest >= 0) {
    const group = episode.of("person group")[nearest][frame];
    const where = group < 0 ? "" : `, member of group ${group}`;
    return `person ${nearest}: ${speedOf(episode, nearest, frame).toFixed(2)} m/s${where}`;
  }
  const nodes = graph ? recording.graph : null;
  const node = nodes?.position.findIndex(([nx, ny], k) => Math.hypot(nx - x, ny - y) < nodes.radius[k]) ?? -1;
  if (nodes && node >= 0) {
    return `${nodes.group[node] ? "group node" : "node"} ${nodes.names[node]}, radius ${nodes.radius[node].toFixed(1)} m`;
  }
  for (const [cx, cy, hx, hy, yaw, height] of recording.place.obstacles) {
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    const [u, v] = [c * (x - cx) + s * (y - cy), c * (y - cy) - s * (x - cx)];
    if (height > 0 && Math.abs(u) < hx && Math.abs(v) < hy) {
      return `obstacle, ${(2 * hx).toFixed(1)} × ${(2 * hy).toFixed(1)} m, ${height.toFixed(1)} m high`;
    }
  }
  return "";
}

function speedOf(episode: Episode, n: number, frame: number): number {
  const [xs, ys] = [episode.of("person x")[n], episode.of("person y")[n]];
  const from = Math.max(0, Math.min(frame, episode.frames - 2));
  const to = Math.min(from + 1, episode.frames - 1);
  return Math.hypot(xs[to] - xs[from], ys[to] - ys[from]) / episode.timeStep;
}
