"""An animation of a folder of pictures, as ``film.mjs`` makes them: python web/film.py FOLDER FILE.gif [SECONDS]"""

import sys
from collections import Counter
from pathlib import Path

from PIL import Image

COLORS = 160

folder, target, seconds = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]) if len(sys.argv) > 3 else 0.1
frames = [Image.open(path).convert("RGB") for path in sorted(folder.glob("*.png"))]
counts = Counter[tuple[int, int, int]]()
for frame in frames:  # one palette for all, so that nothing flickers: areas of one color keep it exactly
    counts.update(
        {color: min(count, 300) + count // 1000 for count, color in frame.getcolors(2**24) or [] if count > 30}
    )
common = [value for color, _ in counts.most_common(COLORS) for value in color]
palette = Image.new("P", (1, 1))
palette.putpalette(common)
first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
first.save(target, save_all=True, append_images=others, duration=round(1000 * seconds), loop=0, optimize=True)
