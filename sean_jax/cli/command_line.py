"""The command line: ``sean run``, ``collect``, ``train``, ``experiment``, ``export``, ``draw``, ``bench``, ...

Nothing heavy is imported before a command is chosen, so that ``sean --help`` answers at once. The module ``commands``
beside this one has what each command does.
"""

import logging
import os
import re
import signal
import sys
import threading
import traceback
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from sean_jax import __version__, config
from sean_jax.cli.commands import DO, FAILED, STOPPED, TERMINATED, WRONG, fail
from sean_jax.config import COMMANDS, GROUPS, Config, flags
from sean_jax.core.errors import IncompleteError, InputError, PartError
from sean_jax.core.messages import suggest
from sean_jax.io import interrupts
from sean_jax.io.writing import broken, contents

LEARNING = ("cmaes", "optax", "orbax", "tensorstore")  # packages of the extra "learning"
RESUMABLE = ("collect", "train", "experiment", "export", "calibrate", "benchmark run", "validate")
CONFIGURABLE = ("run", "collect", "train", "studio", "bridge")  # take options from a file, and as key=value, too
READERS = (*CONFIGURABLE, "experiment", "export", "replay", "benchmark")  # may run code that a file names
OUT_OF_MEMORY = (
    "the device is out of memory; set XLA_PYTHON_CLIENT_MEM_FRACTION=0.95 (JAX takes 0.75 of a GPU), "
    "or choose fewer episodes or scenarios at once. The same command resumes an unfinished experiment."
)
TRACEBACK = "--traceback"  # of any command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: the words after ``sean``; sys.argv if None.

    Returns:
        The exit code: 0, 2 for bad input, 1 for work that broke midway, 130 for Ctrl-C and 143 for SIGTERM.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None:  # then the process is ours
        _mute_orbax()
    if traced := TRACEBACK in words:
        words.remove(TRACEBACK)
    code = STOPPED
    received = []
    try:
        with interrupts.interruptible() as received:
            code = _main(words, traced)
    except KeyboardInterrupt:  # at the very end, while memory is freed, or a second one during the answer to the first
        pass
    except Exception as error:
        if arguments is not None or not interrupts.is_compiling():
            raise
        sys.excepthook(type(error), error, error.__traceback__)
        code = FAILED
    code = TERMINATED if code == STOPPED and signal.SIGTERM in received else code
    if arguments is None and interrupts.is_compiling():
        sys.stdout.flush()
        os._exit(code)  # the compiler cannot be interrupted, and the interpreter would wait for it
    if code in (FAILED, STOPPED, TERMINATED) and _is_joined():
        sys.stdout.flush()
        os._exit(code)  # without jax.distributed's exit barrier: other hosts may be blocked on this one
    return code


def _mute_orbax() -> None:
    """Print no traceback besides the raised error: of orbax's tasks, and of threads that find its loop closed."""
    logging.getLogger("absl").disabled = True  # orbax logs every step
    logging.getLogger("asyncio").addFilter(lambda record: "orbax" not in record.getMessage())
    hook = sys.unraisablehook

    def unraisable(event: Any) -> None:
        closed = isinstance(event.exc_value, RuntimeError) and "Event loop is closed" in str(event.exc_value)
        if not closed or threading.current_thread() is threading.main_thread():
            hook(event)

    sys.unraisablehook = unraisable


def _is_joined() -> bool:
    """Whether this process is one of several that train together."""
    jax = sys.modules.get("jax")
    return jax is not None and jax.distributed.is_initialized()


def _main(words: list[str], traced: bool) -> int:
    """The exit code of a command; ``traced`` prints the traceback of an error before its sentence."""
    if words in (["--version"], ["-V"]):
        print(f"sean_jax {__version__}")
        return 0
    if not words or words[0] in ("--help", "-h"):
        print(_help())
        return 0 if words else WRONG
    if words[0] in GROUPS and words[1:2] in (["--help"], ["-h"]):
        print(_help(words[0]))
        return 0
    try:
        return _execute(words)
    except (Exception, KeyboardInterrupt) as error:
        code = _explain(error, traced)
        if code is None:
            raise
        return code


def _execute(words: list[str]) -> int:
    """Parse the words of a command and execute it."""
    name = _name(words)
    _refuse_empty(words)
    model = COMMANDS[name]
    word = words[0]
    parsed = flags.parse(name, model, words[1:], configurable=word in CONFIGURABLE, trust=word in READERS)
    from sean_jax.cli import xla_flags
    from sean_jax.config import user_parts

    with user_parts.read_once(), user_parts.trust() if parsed.get("trust") else nullcontext():
        xla_flags.configure()  # before JAX is imported, as by code of the user's own
        options = _read(model, parsed)
        try:
            return _do(name, options)
        except InputError as error:
            if _begins_with(error, _names_of_file(options, parsed)):
                error.args = (f"{parsed['config']}: {error}",)
            raise


def _names_of_file(options: Config, parsed: Mapping[str, Any]) -> set[str]:
    """The options, and the options of their components, that the file of --config has and no word of the user."""
    names = set[str]()
    for name in options.model_fields_set if "config" in parsed else ():
        part = getattr(options, name)
        names |= {name, *(part.model_fields_set if isinstance(part, config.Component) else ())}
    added = {name for name, family in config.families(type(options)).items() if family.singular in parsed}
    return names - parsed.keys() - added


def _begins_with(error: InputError, names: set[str]) -> bool:
    """Whether a sentence begins with one of the options, as ``people: 9`` and ``environment 'moon'`` do."""
    found = re.match(r"(--)?[a-z][a-z_-]*(?=[.: ])", str(error))
    return found is not None and flags.field_of(found[0]) in names


def _explain(error: BaseException, traced: bool) -> int | None:
    """Print the sentence of an error, and return its exit code; None for an error of the program itself."""
    if isinstance(error, InputError):
        if traced:
            traceback.print_exception(error)
        return fail(_hinted(error, traced), WRONG)
    if isinstance(error, IncompleteError | FloatingPointError):
        return fail(str(error), FAILED)
    if isinstance(error, OSError):
        return fail(f"{broken(error)}; nothing was written.", WRONG)
    if isinstance(error, KeyboardInterrupt):
        return fail(str(error) or "stopped; nothing was written.", STOPPED)

    if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] in LEARNING:
        return fail(f'{error.name} is missing; pip install "sean_jax[learning]".', WRONG)
    if isinstance(error, RuntimeError):
        from sean_jax.core.devices import is_out_of_memory

        if is_out_of_memory(error):
            if traced:
                traceback.print_exception(error)
            return fail(OUT_OF_MEMORY, FAILED)
    return None


def _hinted(error: InputError, traced: bool) -> str:
    """The sentence of an error; for one in the user's own code, with the option that shows its traceback."""
    if traced or not isinstance(error, PartError) or error.__cause__ is None:
        return str(error)
    return f"{str(error).rstrip('.')} ({TRACEBACK} shows where it comes from)."


def _words(group: str = "") -> dict[str, str]:
    """The words that can follow ``sean``, or ``sean train`` of a group, with their summaries."""
    start = f"{group} " if group else ""
    commands = {name.removeprefix(start): model for name, model in COMMANDS.items() if name.startswith(start)}
    return {name.split()[0]: _summary(model.__doc__) for name, model in commands.items()} | ({} if group else GROUPS)


def _summary(text: str | None) -> str:
    """The first sentence of a text."""
    return flags.joined(text).partition(". ")[0].rstrip(".") + "."


def _help(group: str = "") -> str:
    """The commands, or the commands of a group, a line each."""
    words = _words(group)
    sean = f"sean {group}".strip()
    width = max(map(len, words))
    lines = [f"  {word:<{width}}  {summary}" for word, summary in words.items()]
    about = GROUPS.get(group, "Social robot navigation in JAX: simulate, measure, report.")
    tail = f"For options: `{sean} COMMAND --help`; `sean --version` shows this version, {TRACEBACK} where an error is."
    return "\n".join([f"usage: {sean} COMMAND [OPTIONS]\n\n{about}\n\ncommands:", *lines, "", tail])


def _name(words: list[str]) -> str:
    """The name of a command in ``COMMANDS``.

    Raises:
        InputError: there is no such command.
    """
    group = words[0] if words[0] in GROUPS else ""
    name = " ".join(words[:2] if group else words[:1])
    if name not in COMMANDS:
        word = name.removeprefix(group).strip()
        known = _words(group)
        cure = suggest(word, known) or f"; `{f'sean {group}'.strip()} --help` describes them."
        raise InputError(f"{group and f'{group}: '}'{word}' is not one of {', '.join(known)}{cure}")
    return name


def _read(model: type[Config], parsed: Mapping[str, Any]) -> Any:
    """The options of parsed words, and of the file of --config."""
    source = parsed.get("config")
    if source is None:
        return flags.read(model, parsed, typed=True)
    from sean_jax.evaluation.run_folder import read_config

    saved = read_config(source)
    description = saved.description
    for name, value in description.items():
        if isinstance(value, str):
            flags.check_text(f"{source}: {name}", value)
    if saved.is_run and model is not config.RunConfig and issubclass(model, config.ScenarioConfig):
        description = _scenario_of(description, model)
        if not parsed.get("quiet"):
            left = ", ".join(name for name in saved.description if name not in description)
            print(f"note: {source} is of a run; its scenario is taken, without {left}.")
    needed = (*flags.positionals(model), *config.TRANSPORTS)  # which a file need not have
    words = {name: value for name, value in parsed.items() if name in needed}
    try:
        config.validate(model, description | words, source=source)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    options = flags.read(model, parsed, description, source, typed=True)
    _refuse_open_port(options, parsed, source)
    return options


def _scenario_of(description: Mapping[str, Any], model: type[Config]) -> dict[str, Any]:
    """The scenario of a run's description, as far as it affects the results of another command."""
    fields = {name: model.model_fields[name] for name in config.ScenarioConfig.model_fields}
    return {
        name: value
        for name, value in description.items()
        if name in fields and config.Option.of(fields[name]).affects_results
    }


def _refuse_open_port(options: config.Config, parsed: Mapping[str, Any], source: Path) -> None:
    """Refuse a port that other computers reach, unless the user types its address or trusts the file that has it."""
    if isinstance(options, config.BridgeConfig):
        field, place = "address", options.place
    else:
        field, policy = "policy", getattr(options, "policy", None)
        place = config.outside(policy) if isinstance(policy, config.Component) else None
    if place is None or field in parsed:
        return
    from sean_jax.config import user_parts
    from sean_jax.ros.names import is_open

    if user_parts.is_trusting() or not is_open(place):
        return
    raise InputError(
        f"{field}: {source} opens {place[1]} to other computers, and you did not; "
        f"type --{field} yourself, or add --trust."
    )


def _refuse_empty(arguments: list[str]) -> None:
    """Refuse empty words, and flags with an empty text."""
    for before, word in zip(["", *arguments], arguments, strict=False):
        option, equals, value = word.partition("=")
        if option.startswith("--") and equals:
            flags.check_text(option, value)
        flags.check_text(before if before.startswith("--") else "an argument", word)


def _do(name: str, options: Any) -> int:
    """The exit code of a command; resumable work keeps its finished parts after an error or Ctrl-C."""
    from rich.console import Console

    try:
        with interrupts.unwrapped():
            return DO[name](options, Console(quiet=getattr(options, "quiet", False))) or 0
    except (OSError, KeyboardInterrupt) as error:
        if not name.startswith(RESUMABLE):
            raise
        kept = "nothing was written."
        if contents(options.folder):
            kept = f"finished parts are in {options.folder}, and the same command resumes."
        if isinstance(error, KeyboardInterrupt):
            return fail(f"stopped; {kept}", STOPPED)
        return fail(f"{broken(error)}; {kept}", FAILED)


if __name__ == "__main__":
    sys.exit(main())
