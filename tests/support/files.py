"""Files that tests write, and what folders hold."""

from pathlib import Path


def write(path: Path, text: str) -> Path:
    """A file with that text, in a folder that is made if it is not there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def write_all(folder: Path, texts: dict[str, str]) -> Path:
    """A folder with files by their names."""
    for name, text in texts.items():
        write(folder / name, text)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """The bytes of all files in a folder, by their paths in it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
