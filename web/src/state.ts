// What a person does, by color: walks, stands in a group, yields to the robot.

import type { Episode } from "./recording";

const NEAR = 2; // m, from the robot
const SLOW = 0.5; // of the usual speed
const WINDOW = 0.3; // s, before and after a moment: places are whole centimetres
const WALKING = 0.3; // m/s, at least
const SAMPLE = 5; // frames from one speed to the next

export type State = "person" | "member" | "yielding";

/** m/s, of a person about a frame. */
export function speedOf(episode: Episode, n: number, frame: number): number {
  const [xs, ys, present] = ["person x", "person y", "person present"].map((name) => episode.of(name)[n]);
  const reach = Math.max(1, Math.round(WINDOW / episode.timeStep));
  let [from, to] = [frame, frame];
  while (from > Math.max(0, frame - reach) && present[from - 1] > 0.5) from--;
  while (to < Math.min(episode.frames - 1, frame + reach) && present[to + 1] > 0.5) to++;
  return to > from ? Math.hypot(xs[to] - xs[from], ys[to] - ys[from]) / ((to - from) * episode.timeStep) : 0;
}

const usual = new WeakMap<Episode, Map<number, { frames: number; speed: number }>>();

/** m/s, the median of a person's speeds while walking; 0 if the person never walks. */
function usualSpeed(episode: Episode, n: number): number {
  if (!usual.has(episode)) usual.set(episode, new Map());
  const known = usual.get(episode)!;
  const last = known.get(n);
  if (last && last.frames <= episode.frames && episode.frames < 1.2 * last.frames) return last.speed; // a live one grows
  const speeds: number[] = [];
  for (let t = 0; t < episode.frames; t += SAMPLE) speeds.push(speedOf(episode, n, t));
  const walked = speeds.filter((speed) => speed > WALKING).sort((one, other) => one - other);
  const speed = walked.length ? walked[Math.floor(walked.length / 2)] : 0;
  known.set(n, { frames: episode.frames, speed });
  return speed;
}

/** A person yields if the robot is within 2 m ahead and the person walks at less than half of the usual speed. */
export function stateOf(episode: Episode, n: number, frame: number): State {
  if (episode.of("person group")[n][frame] >= 0) return "member";
  const robot = episode.of("robot x")[0];
  if (!robot) return "person";
  const dx = robot[frame] - episode.of("person x")[n][frame];
  const dy = episode.of("robot y")[0][frame] - episode.of("person y")[n][frame];
  const heading = episode.of("person heading")[n][frame];
  if (dx * dx + dy * dy > NEAR * NEAR || dx * Math.cos(heading) + dy * Math.sin(heading) <= 0) return "person";
  return speedOf(episode, n, frame) < SLOW * usualSpeed(episode, n) ? "yielding" : "person";
}
