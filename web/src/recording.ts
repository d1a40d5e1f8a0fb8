// A recording: what the page was given, and its episodes as numbers.
// The layout is that of sean_jax/replay/__init__.py, which says why.

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
  columns: Columns[];
  data: string; // base64
}

export interface Recording {
  version: number;
  title: string;
  place: Place;
  graph: Graph | null;
  robot: { name: string; radius: number; views: View[] } | null; // null: people alone
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

  /** Frames that follow. */
  append(more: Episode): void {
    for (const [name, columns] of this.columns) {
      const joined = columns.map((column, k) => {
        const both = new Float32Array(this.frames + more.frames);
        both.set(column);
        both.set(more.of(name)[k], this.frames);
        return both;
      });
      this.columns.set(name, joined);
    }
    this.frames += more.frames;
  }

  /** s, of the last frame. */
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

  /** The value of a column at a time [s], between two frames. */
  at(column: Float32Array, time: number): number {
    const frame = this.frameAt(time);
    const next = Math.min(frame + 1, this.frames - 1);
    const share = Math.max(0, Math.min(1, time / this.timeStep - frame));
    return column[frame] + share * (column[next] - column[frame]);
  }

  /** As `at`, of an angle [rad], the shorter way round. */
  angleAt(column: Float32Array, time: number): number {
    const frame = this.frameAt(time);
    const next = Math.min(frame + 1, this.frames - 1);
    const share = Math.max(0, Math.min(1, time / this.timeStep - frame));
    const turn = ((column[next] - column[frame] + 3 * Math.PI) % (2 * Math.PI)) - Math.PI;
    return column[frame] + share * turn;
  }
}

/** The numbers of an episode. */
export async function decode(head: EpisodeHead, timeStep: number): Promise<Episode> {
  const packed = Uint8Array.from(atob(head.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
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
