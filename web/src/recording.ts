// A recording: what the page was given, and its episodes as numbers.
// The layout is that of sean_jax/web/replay/__init__.py, which says why.

export interface Place {
  name: string;
  floor: [number, number, number, number]; // m: low x, low y, high x, high y
  obstacles: number[][]; // center x, y, half extents, yaw, height; m and rad
}

export interface Graph {
  names: string[];
  position: number[][]; // m
  radius: number[]; // m
  group: boolean[];
  edges: [number, number, string][]; // from, to, flow
}

export interface View {
  name: string;
  angle: number; // rad, from edge to edge
  range: number; // m
}

export interface Curve {
  name: string;
  unit: string;
  marks: [number, string][]; // values of note, such as the intimate distance
}

export interface Columns {
  name: string;
  count: number;
  scale: number;
  offset: number;
}

export interface EpisodeHead {
  title: string;
  outcome: string;
  frames: number;
  begin?: number; // steps before the first frame; 0 if it is left out
  columns: Columns[];
  data: string; // base64
}

export interface Recording {
  version: number;
  title: string;
  place: Place;
  graph: Graph | null;
  robot: { name: string; radius: number; views: View[]; others?: number[] } | null; // null: people alone; others: m, radii
  person: { radius: number };
  situations: { name: string; color: string }[];
  curves: Curve[];
  timeStep: number; // s
  episodes: EpisodeHead[];
  live?: string; // the address of the episode's frames, while it is simulated
}

/** An episode: columns of T numbers each, one after the other. */
export class Episode {
  frames: number;

  constructor(
    readonly head: EpisodeHead,
    readonly timeStep: number,
    private readonly columns: Map<string, Float32Array[]>,
  ) {
    this.frames = head.frames;
  }

  /** Frames that follow, without the first `skip` of them. */
  append(more: Episode, skip = 0): void {
    const frames = this.frames + more.frames - skip;
    for (const [name, columns] of this.columns) {
      const grown = columns.map((column, k) => {
        let room = new Float32Array(column.buffer as ArrayBuffer);
        if (room.length < frames) {
          room = new Float32Array(2 * frames);
          room.set(column);
        }
        room.set(more.of(name)[k].subarray(skip), this.frames);
        return room.subarray(0, frames);
      });
      this.columns.set(name, grown);
    }
    this.frames = frames;
  }

  /** Forget all but the first frames. */
  cut(frames: number): void {
    this.frames = Math.min(this.frames, frames);
    for (const [name, columns] of this.columns) {
      this.columns.set(name, columns.map((column) => column.subarray(0, this.frames)));
    }
  }

  /** s, from the beginning of the episode to the first frame. */
  get begin(): number {
    return (this.head.begin ?? 0) * this.timeStep;
  }

  /** s, from the first frame to the last. */
  get duration(): number {
    return (this.frames - 1) * this.timeStep;
  }

  /** All columns of a name; none if the recording has none. */
  of(name: string): Float32Array[] {
    return this.columns.get(name) ?? [];
  }

  /** The frame that was last at a time [s]. */
  frameAt(time: number): number {
    return Math.max(0, Math.min(this.frames - 1, Math.floor(time / this.timeStep + 1e-6)));
  }

  /** Steps beyond the last frame, for which motion goes on: a live episode is drawn more often than it is simulated. */
  private beyond(time: number): number {
    return Math.min(1, (time - this.duration) / this.timeStep);
  }

  /** The value of a column at a time [s], between two frames. */
  at(column: Float32Array, time: number): number {
    const frame = this.frameAt(time);
    const next = Math.min(frame + 1, this.frames - 1);
    const share = Math.max(0, Math.min(1, time / this.timeStep - frame));
    if (time > this.duration && frame > 0) return column[frame] + this.beyond(time) * (column[frame] - column[frame - 1]);
    return column[frame] + share * (column[next] - column[frame]);
  }

  /** As `at`, of an angle [rad], the shorter way round. */
  angleAt(column: Float32Array, time: number): number {
    const frame = this.frameAt(time);
    const next = Math.min(frame + 1, this.frames - 1);
    const share = Math.max(0, Math.min(1, time / this.timeStep - frame));
    const turn = (from: number, to: number): number => ((column[to] - column[from] + 3 * Math.PI) % (2 * Math.PI)) - Math.PI;
    if (time > this.duration && frame > 0) return column[frame] + this.beyond(time) * turn(frame - 1, frame);
    return column[frame] + share * turn(frame, next);
  }
}

/** The numbers of an episode. */
export async function decode(head: EpisodeHead, timeStep: number): Promise<Episode> {
  const packed = Uint8Array.from(atob(head.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  return unpack(head, timeStep, bytes);
}

/** The numbers of an episode, or of a part, whose bytes are not deflated. */
export function unpack(head: EpisodeHead, timeStep: number, bytes: Uint8Array): Episode {
  const length = bytes.length / 2; // low bytes first, then high bytes
  const columns = new Map<string, Float32Array[]>();
  let place = 0;
  for (const { name, count, scale, offset } of head.columns) {
    const some: Float32Array[] = [];
    for (let k = 0; k < count; k++) {
      const values = new Float32Array(head.frames);
      let sum = 0;
      for (let t = 0; t < head.frames; t++, place++) {
        sum = (sum + bytes[place] + 256 * bytes[length + place]) & 0xffff;
        values[t] = sum * scale + offset;
      }
      some.push(values);
    }
    columns.set(name, some);
  }
  return new Episode(head, timeStep, columns);
}
