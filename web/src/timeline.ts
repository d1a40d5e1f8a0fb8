// Below the plan: when each situation held, and metrics as curves, over time.

import type { Palette } from "./palette";
import type { Episode, Recording } from "./recording";

export const STRIP = 18; // pixels, of a situation
const CURVE = 46; // of a curve
const GAP = 8;
const SHORTEST = 1; // s, of an episode of which strips and curves are drawn
export const LABELS = 118; // pixels at the left

/** Pixels that the timeline needs. */
export function timelineHeight(recording: Recording): number {
  return recording.situations.length * STRIP + GAP + recording.curves.length * (CURVE + GAP);
}

/** Draw what does not change while time passes. */
export function drawTimeline(
  paint: CanvasRenderingContext2D,
  width: number,
  palette: Palette,
  recording: Recording,
  episode: Episode,
): void {
  const across = (t: number): number => LABELS + ((width - LABELS) * t) / Math.max(1, episode.frames - 1);
  const short = episode.duration < SHORTEST; // there is no range yet
  paint.clearRect(0, 0, width, timelineHeight(recording));
  paint.font = "12px system-ui, sans-serif";
  paint.textBaseline = "middle";
  const label = (text: string, y: number, color: string): void => {
    paint.fillStyle = color;
    paint.fillText(text, 0, y, LABELS - 8);
  };

  recording.situations.forEach(({ color }, index) => {
    const [top, flags] = [index * STRIP, episode.of("situation")[index]];
    paint.fillStyle = palette.floor;
    paint.fillRect(LABELS, top + 2, width - LABELS, STRIP - 5);
    paint.fillStyle = color;
    for (let t = 0; !short && t < episode.frames; ) {
      const first = t;
      while (t < episode.frames && flags[t] > 0.5) t++;
      if (t > first) {
        const [from, to] = [Math.max(LABELS, across(first - 0.5)), Math.min(width, across(t - 0.5))];
        paint.fillRect(from, top + 2, Math.max(1.5, to - from), STRIP - 5);
      }
      t++;
    }
  });

  recording.curves.forEach(({ name, unit, marks }, index) => {
    const top = recording.situations.length * STRIP + GAP + index * (CURVE + GAP);
    const column = episode.of(name)[0];
    const values = Array.from(column).filter(Number.isFinite);
    const high = Math.max(...values, 1e-3);
    const low = Math.min(...values, 0);
    const down = (value: number): number => top + CURVE - (CURVE * (value - low)) / (high - low);
    label(name, top + 8, palette.ink);
    paint.fillStyle = palette.floor;
    paint.fillRect(LABELS, top, width - LABELS, CURVE);
    if (short) return;
    label(`${low.toPrecision(2)} to ${high.toPrecision(2)} ${unit}`, top + 24, palette.muted);
    const shown = marks.filter(([value]) => value >= low && value <= high);
    paint.fillStyle = palette.muted;
    for (const [value] of shown) paint.fillRect(LABELS, down(value), width - LABELS, 1);
    paint.beginPath();
    for (let t = 0; t < episode.frames; t++) paint.lineTo(across(t), down(column[t]));
    paint.strokeStyle = palette.ink;
    paint.lineWidth = 1.3;
    paint.stroke();
    paint.strokeStyle = palette.floor; // around the words, so that the curve does not cross them
    paint.lineWidth = 4;
    paint.lineJoin = "round";
    for (const [place, [value, text]] of shown.entries()) {
      paint.textAlign = place % 2 ? "left" : "right"; // apart, since values of note lie near one another
      const [x, y] = [place % 2 ? LABELS + 4 : width - 4, down(value) - 7];
      paint.strokeText(text, x, y);
      paint.fillText(text, x, y);
    }
    paint.textAlign = "left";
  });
}
