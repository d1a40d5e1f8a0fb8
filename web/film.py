"""An animation of a folder of pictures, as ``film.mjs`` makes them: python web/film.py FOLDER FILE.gif [SECONDS]"""

import sys
from pathlib import Path

from PIL import Image

folder, target, seconds = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]) if len(sys.argv) > 3 else 0.125
frames = [Image.open(path).convert("RGB") for path in sorted(folder.glob("*.png"))]
width, height = frames[0].size
sample = Image.new("RGB", (3 * width, height))
for turn in range(3):  # one palette for all, so that nothing flickers
    sample.paste(frames[turn * len(frames) // 3], (turn * width, 0))
palette = sample.quantize(128, method=Image.Quantize.MAXCOVERAGE)
first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
first.save(target, save_all=True, append_images=others, duration=round(1000 * seconds), loop=0, optimize=True)
