// An episode that is still simulated: the page asks for what has come since (sean_jax/web/replay/live.py).

import { decode, type Episode, type EpisodeHead } from "./recording";

interface Told {
  chunks: EpisodeHead[];
  over: boolean; // the episode has ended
  outcome: string;
}

export class Stream {
  episode: Episode | null = null;
  over = false;
  outcome = "waiting for the first frames";
  private chunks = 0;

  constructor(
    private readonly address: string,
    private readonly timeStep: number,
  ) {}

  /** Ask once; whether frames came. */
  async poll(): Promise<boolean> {
    let told: Told;
    try {
      told = (await (await fetch(`${this.address}?from=${this.chunks}`)).json()) as Told;
    } catch {
      [this.over, this.outcome] = [true, "the run has ended"];
      return false;
    }
    for (const head of told.chunks) {
      const more = await decode(head, this.timeStep);
      if (this.episode) this.episode.append(more);
      else this.episode = more;
      this.chunks++;
    }
    this.over = told.over;
    this.outcome = told.over ? told.outcome : this.episode ? "live" : this.outcome;
    return told.chunks.length > 0;
  }
}
