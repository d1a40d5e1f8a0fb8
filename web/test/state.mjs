// States and next nodes of all people at all moments of a replay page's first episode, as JSON: [person][frame].
// node test/state.mjs PAGE.html

import { readFileSync } from "node:fs";
import { build } from "esbuild";

const contents = `
  export { decode } from "./recording";
  export { nextNode } from "./pick";
  export { stateOf } from "./state";
`;
const resolveDir = new URL("../src", import.meta.url).pathname;
const bundle = await build({ stdin: { contents, resolveDir, loader: "ts" }, bundle: true, format: "esm", write: false });
const { decode, nextNode, stateOf } = await import(`data:text/javascript;base64,${Buffer.from(bundle.outputFiles[0].contents).toString("base64")}`);
const page = readFileSync(process.argv[2], "utf8");
const recording = JSON.parse(/<script type="application\/json" id="[^"]*">(.*?)<\/script>/s.exec(page)[1]);
const episode = await decode(recording.episodes[0], recording.timeStep);
const all = (value) =>
  episode.of("person x").map((_, n) => Array.from({ length: episode.frames }, (_, frame) => value(n, frame)));
const states = all((n, frame) => stateOf(episode, n, frame));
console.log(JSON.stringify({ states, next: all((n, frame) => nextNode(recording, episode, n, frame)) }));
