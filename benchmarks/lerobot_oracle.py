"""Read an exported dataset by LeRobot, write it again by LeRobot's own writer, and compare the two.

LeRobot 0.6 installs PyTorch and needs Python 3.12, so use a separate environment, without sean_jax:

pip install "lerobot[dataset]==0.6.1"
python benchmarks/lerobot_oracle.py runs/lerobot
python benchmarks/lerobot_oracle.py runs/lerobot --record tests/support/data/lerobot_schema.json
"""

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from options import Option, parser

DEPTH = "observation.images.depth"
WRITTEN_BY_LEROBOT = ("timestamp", "frame_index", "episode_index", "index", "task_index")
BIN = 1 / 5000  # share of a feature's range: LeRobot reads its quantiles from histograms of 5000 bins


def rewrite(dataset: Any, root: Path) -> None:
    """Write the dataset by LeRobot's own writer, with statistics of all images instead of a sample."""
    from lerobot.datasets import compute_stats
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    compute_stats.estimate_num_samples = lambda length: length
    features = {}
    for name, feature in dataset.meta.features.items():
        if name not in WRITTEN_BY_LEROBOT:
            features[name] = {**feature, "shape": tuple(feature["shape"])}
    features[DEPTH]["info"] = {"is_depth_map": True}
    shared = {"fps": dataset.fps, "robot_type": dataset.meta.robot_type, "use_videos": False}
    written = LeRobotDataset.create("local/own", features=features, root=root, **shared)
    for episode in dataset.meta.episodes:
        for index in range(episode["dataset_from_index"], episode["dataset_to_index"]):
            item = dataset[index]
            frame = {name: np.atleast_1d(item[name].numpy()) for name in features}
            frame[DEPTH] = frame[DEPTH][0, ..., None].astype(np.uint16)
            written.add_frame({**frame, "task": item["task"]})
        written.save_episode()
    written.finalize()


def schema(root: Path) -> dict[str, Any]:
    """The schema of a dataset's files: info.json, the shapes of statistics, the columns of tables."""
    import pyarrow.parquet as pq

    stats = json.loads((root / "meta/stats.json").read_text())
    tables = ("data/chunk-000/file-000", "meta/episodes/chunk-000/file-000", "meta/tasks")
    return {
        "info": json.loads((root / "meta/info.json").read_text()),
        "stats": {
            name: {key: np.shape(value) for key, value in statistics.items()} for name, statistics in stats.items()
        },
        "tables": {
            name: {column.name: str(column.type) for column in pq.read_schema(root / f"{name}.parquet")}
            for name in tables
        },
    }


def compare(root: Path, written: Path) -> list[str]:
    """Lines about differences beyond rounding."""
    import pyarrow.parquet as pq

    lines = []
    ours, theirs = schema(root), schema(written)
    for part, content in theirs.items():
        for name in sorted(content.keys() | ours[part].keys()):
            if ours[part].get(name) != content.get(name):
                lines.append(f"{part} {name}: {ours[part].get(name)}, and LeRobot {content.get(name)}")
    first, second = (
        pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pydict() for folder in (root, written)
    )
    worst = 0.0
    for column, values in first.items():
        if not column.startswith("stats/"):
            lines += [] if values == second[column] else [f"episodes {column}: {values}, and LeRobot {second[column]}"]
            continue
        span = [
            np.maximum(np.subtract(high, low), 1e-6)
            for high, low in zip(*(first[f"{column.rsplit('/', 1)[0]}/{end}"] for end in ("max", "min")), strict=True)
        ]
        for value, other, folder in zip(values, second[column], span, strict=True):
            worst = max(worst, float(np.abs(np.subtract(value, other) / folder).max()))
    print(f"statistics of {len(first['length'])} episodes differ by {worst / BIN:.2f} bins of a histogram at most")
    return lines + (["statistics of episodes differ by more than a bin"] if worst > 1.01 * BIN else [])


def normalised(dataset: Any) -> list[str]:
    """Lines about depth that LeRobot's normalizer does not bring to mean 0 and deviation 1."""
    import torch
    from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
    from lerobot.processor import NormalizerProcessorStep

    images = torch.stack([dataset[index][DEPTH] for index in range(len(dataset))])
    kind, lines = PolicyFeature(FeatureType.VISUAL, tuple(images.shape[1:])), []
    for mode in (NormalizationMode.MEAN_STD, NormalizationMode.MIN_MAX, NormalizationMode.QUANTILES):
        step = NormalizerProcessorStep({DEPTH: kind}, {FeatureType.VISUAL: mode}, dataset.meta.stats)
        values = step._normalize_observation({DEPTH: images}, inverse=False)[DEPTH]
        print(f"depth by {mode.value}: mean {values.mean():.3f}, std {values.std():.3f}, to {values.abs().max():.1f}")
        if mode == NormalizationMode.MEAN_STD and (abs(values.mean()) > 1e-3 or abs(values.std() - 1) > 1e-3):
            lines.append("depth by MEAN_STD has not mean 0 and standard deviation 1")
        if mode == NormalizationMode.MIN_MAX and values.abs().max() > 1 + 1e-5:
            lines.append("depth by MIN_MAX is not from -1 to 1")
        if mode == NormalizationMode.QUANTILES and (values.abs() <= 1 + 1e-5).float().mean() < 0.98:
            lines.append("depth by QUANTILES: less than 98 % are from -1 to 1")
    return lines


def main() -> None:
    """Print the differences; exit code 1 if there are any."""
    import lerobot
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    arguments = parser(__doc__, record=Option(None, "file for the schema of LeRobot's own files", kind=Path))
    arguments.add_argument("folder", type=Path)
    chosen = arguments.parse_args()
    dataset = LeRobotDataset("local/exported", root=chosen.folder)
    print(f"LeRobot {lerobot.__version__} reads {len(dataset)} frames of {dataset.num_episodes} episodes")
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "own"
        rewrite(dataset, written)
        lines = compare(chosen.folder, written) + normalised(dataset)
        if chosen.record is not None:
            recorded = {"lerobot": lerobot.__version__, **schema(written)}
            chosen.record.write_text(json.dumps(recorded) + "\n", encoding="utf-8")
    print("\n".join(lines) if lines else "nothing differs")
    raise SystemExit(bool(lines))


if __name__ == "__main__":
    main()
