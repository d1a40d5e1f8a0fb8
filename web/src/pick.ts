// What lies at a place of the plan, and its description.

import type { Episode, Recording } from "./recording";
import { speedOf, stateOf } from "./state";

const REACH = 0.35; // m, around people and the robot

export interface Thing {
  kind: "robot" | "person" | "node" | "obstacle";
  index: number;
}

/** The robot, a person, a node or an obstacle at a place [m]; null elsewhere. */
export function pick(
  recording: Recording,
  episode: Episode,
  time: number,
  graph: boolean,
  x: number,
  y: number,
  pixel: number, // m
): Thing | null {
  const frame = episode.frameAt(time);
  const at = (name: string, k = 0): number => episode.at(episode.of(name)[k], time);
  const reach = Math.max(REACH, 6 * pixel);
  const robot = recording.robot;
  if (robot && Math.hypot(at("robot x") - x, at("robot y") - y) < Math.max(reach, robot.radius)) {
    return { kind: "robot", index: 0 };
  }
  let [nearest, gap] = [-1, reach];
  episode.of("person present").forEach((flag, n) => {
    const away = flag[frame] > 0.5 ? Math.hypot(at("person x", n) - x, at("person y", n) - y) : Infinity;
    if (away < gap) [nearest, gap] = [n, away];
  });
  if (nearest >= 0) return { kind: "person", index: nearest };
  const node = graph && recording.graph ? nodeAt(recording, x, y) : -1;
  if (node >= 0) return { kind: "node", index: node };
  const obstacle = recording.place.obstacles.findIndex(([cx, cy, hx, hy, yaw, height]) => {
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    const [u, v] = [c * (x - cx) + s * (y - cy), c * (y - cy) - s * (x - cx)];
    return height > 0 && Math.abs(u) < hx && Math.abs(v) < hy;
  });
  return obstacle >= 0 ? { kind: "obstacle", index: obstacle } : null;
}

/** Where a thing is [m]; null for a person who is absent and a node that is gone. */
export function placeOf(thing: Thing, recording: Recording, episode: Episode, time: number): [number, number] | null {
  const at = (name: string): number => episode.at(episode.of(name)[thing.index], time);
  if (thing.kind === "robot") return [at("robot x"), at("robot y")];
  if (thing.kind === "obstacle") return recording.place.obstacles[thing.index].slice(0, 2) as [number, number];
  if (thing.kind === "node") return (recording.graph?.position[thing.index] as [number, number]) ?? null;
  const here = episode.of("person present")[thing.index]?.[episode.frameAt(time)] > 0.5;
  return here ? [at("person x"), at("person y")] : null;
}

/** A thing in words. */
export function describe(thing: Thing, recording: Recording, episode: Episode, time: number): string {
  const { kind, index } = thing;
  if (kind === "robot") {
    const [speed, goal] = ["speed", "distance to goal"].map((name) => episode.at(episode.of(name)[0], time));
    return `${recording.robot!.name}: ${speed.toFixed(2)} m/s, ${goal.toFixed(1)} m to its goal`;
  }
  if (kind === "node") {
    const graph = recording.graph!;
    return `${graph.group[index] ? "group node" : "node"} ${graph.names[index]}, radius ${graph.radius[index].toFixed(1)} m`;
  }
  if (kind === "obstacle") {
    const [, , hx, hy, , height] = recording.place.obstacles[index];
    return `obstacle, ${(2 * hx).toFixed(1)} × ${(2 * hy).toFixed(1)} m, ${height.toFixed(1)} m high`;
  }
  const frame = episode.frameAt(time);
  const group = episode.of("person group")[index][frame];
  const next = nextNode(recording, episode, index, frame);
  const facts = [
    `${speedOf(episode, index, frame).toFixed(1)} m/s`,
    group < 0 ? "" : `member of group ${group}`,
    stateOf(episode, index, frame) === "yielding" ? "yields to the robot" : "",
    next < 0 ? "" : `next node ${recording.graph!.names[next]}`,
  ];
  return `person ${index}: ${facts.filter(Boolean).join(", ")}`;
}

function nodeAt(recording: Recording, x: number, y: number): number {
  const { position, radius } = recording.graph!;
  return position.findIndex(([nx, ny], k) => Math.hypot(nx - x, ny - y) < radius[k]);
}

/** The node that a person enters next in the recording; -1 if there is none. */
export function nextNode(recording: Recording, episode: Episode, n: number, frame: number): number {
  if (!recording.graph) return -1;
  const [xs, ys, present] = ["person x", "person y", "person present"].map((name) => episode.of(name)[n]);
  const now = nodeAt(recording, xs[frame], ys[frame]);
  for (let t = frame + 1; t < episode.frames && present[t] > 0.5; t++) {
    const node = nodeAt(recording, xs[t], ys[t]);
    if (node >= 0 && node !== now) return node;
  }
  return -1;
}
