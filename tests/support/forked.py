"""Commands of ``sean`` as processes that start at once, for tests that start many.

They are forked from a process that has imported what is heavy and started nothing: no backend of JAX, no threads of its
own. This file, run as a program, is that process; it is told what to do by lines of JSON.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path


class Sean:
    """Starts commands and waits for them."""

    def __init__(self, server: subprocess.Popen):
        self.server = server

    def start(self, folder: Path, *arguments: str) -> int:
        """Begin a command in that folder; its process. What it says goes to ``said.txt`` beside the folder."""
        return self._ask(str(folder), str(folder.parent / "said.txt"), list(map(str, arguments)))

    def wait(self, process: int) -> int:
        """Its exit code, or below zero the signal that killed it."""
        return self._ask(process)

    def is_over(self, process: int) -> bool:
        """Whether it has ended."""
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"

    def _ask(self, *words) -> int:
        assert self.server.stdin and self.server.stdout
        self.server.stdin.write(json.dumps(words) + "\n")
        self.server.stdin.flush()
        return int(self.server.stdout.readline())


@contextlib.contextmanager
def sean() -> Iterator[Sean]:
    """A server, until the block ends."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, __file__], **pipes) as server:
        try:
            yield Sean(server)
        finally:
            server.kill()


def _serve() -> None:
    import gc
    import importlib

    heavy = "optax orbax.checkpoint tensorstore matplotlib.figure mujoco scipy.sparse.csgraph rich.progress PIL.Image"
    own = "cli.command_line simulation.making drawing evaluation io.progress simulation.episode_runner"
    with contextlib.redirect_stdout(sys.stderr):
        for name in [*heavy.split(), *(f"sean_jax.{name}" for name in own.split())]:
            importlib.import_module(name)
    from jax._src import xla_bridge

    assert not xla_bridge._backends, "a backend that has begun does not survive a fork"
    gc.collect()
    gc.freeze()  # what is imported is not looked through again and again in each command
    for line in sys.stdin:
        words = json.loads(line)
        if len(words) == 1:
            answer = os.waitstatus_to_exitcode(os.waitpid(words[0], 0)[1])
        elif not (answer := os.fork()):
            _work(*words)
        print(answer, flush=True)


def _work(folder: str, said: str, arguments: list[str]) -> None:
    code = 1
    try:
        os.chdir(folder)
        for descriptor, flags in ((0, os.O_RDONLY), (1, os.O_WRONLY)):
            os.dup2(os.open(os.devnull, flags), descriptor)
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
        from sean_jax.cli import command_line

        code = command_line.main(arguments)
    except KeyboardInterrupt:  # before it began, or when it was over
        code = 128 + signal.SIGINT
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    _serve()
