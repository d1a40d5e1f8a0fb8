"""Code runs only if the user typed its name, or allows it; who does not say who wrote a description trusts nobody."""

import ast
import hashlib
from pathlib import Path

import pytest
import yaml

from sean_jax import config, registry
from sean_jax.cli import command_line
from sean_jax.config import COMMANDS, PPOConfig, RunConfig, ScenarioConfig, StudioConfig, components, flags, user_parts
from sean_jax.core.errors import FileError, InputError
from sean_jax.evaluation.run_folder import read_config
from sean_jax.learning import policy, reinforcement
from sean_jax.simulation import making
from sean_jax.studies.experiments import benchmark
from sean_jax.studies.validation import checks
from support.checkout import callers

PACKAGE = Path(config.__file__).parent.parent
TYPED = {
    "simulation/making.py _as_config": "arguments of a Python caller",
    "simulation/making.py with_task": "an argument of a Python caller",
    "cli/command_line.py _read": "the command line",
    "config/components.py ": "the mark of it",
    "config/components.py OwnPart": "the mark of nobody",
    "config/components.py validate": "hands the caller's word on",
    "evaluation/__init__.py evaluate": "an argument of a Python caller",
    "config/flags.py read": "hands the caller's word on",
    "learning/policy.py _description": "hands the caller's word on",
    "learning/policy.py check_policy": "hands the caller's word on",
    "learning/policy.py load_policy": "hands the caller's word on",
    "mdp/registry.py load": "an argument of a Python caller",
    "studies/experiments/benchmark.py _drive": "an argument of the command line",
    "studies/experiments/benchmark.py read_policy": "hands the caller's word on",
    "studies/experiments/benchmark.py run": "an argument of the command line",
    "studies/experiments/figure4.py _parts": "a flag of the command line",
    "studies/experiments/figure4.py run_figure4": "a flag of the command line",
    "studies/experiments/table1.py cell": "a flag of the command line",
    "studies/experiments/table1.py policies": "a flag of the command line",
    "studies/experiments/verification.py verify": "a flag of the command line, or else a file",
    "studies/validation/__init__.py run": "a flag of the command line",
    "studies/validation/checks.py models_of": "hands the caller's word on",
}
"""Who says whether the user typed a description -> who did."""

MADE = {
    "config/components.py validate": "hands the caller's word on",
    "io/files/__init__.py _validate": "of files, none of which has parts",
    "config/flags.py _own": "words of the command line, as its caller says",
    "io/files/database.py Database.rows": "rows of a database, none of which has parts",
    "studies/survey/answers.py Answers._read_settings": "a study, whose parts are text until they are validated",
    "studies/survey/answers.py Answers.film_lengths": "lengths of films",
    "web/studio/server.py _opened": "choices of the page, and what the user typed",
    "config/learning_options.py ReinforcementConfig.as_run": "parts of a training, which keep who typed them",
    "simulation/making.py _as_config": "arguments of a Python caller",
    "config/learning_options.py EnvConfig.identity": "only becomes text",
    "learning/dagger.py _collect_options": "components, and a folder as Named",
    "social_forces/forces.py Forces.tree_replace": "numbers of forces, no options",
    "studies/experiments/figure4.py Learner.training": "numbers and folders, no parts",
    "mdp/registry.py with_law": "a name or a file of constants, as Named",
}
"""Who makes options of values that it did not write itself -> why nothing in them can name code."""

OPTIONS = ("self", "config", "options", "described", "each", "base", "plain", "given", "made", "fresh", "first")
"""How options are called where they are changed; ``replace`` of arrays is another."""

WAYS = {
    "policy": lambda name: policy.load_policy(name, None),
    "check": lambda name: policy.check_policy(name, RunConfig()),
    "benchmark": lambda name: policy.load_policy(benchmark.read_policy(name), None),
    "models": checks.models_of,
    **{
        field: lambda name, field=field: making.plan_scenario(
            config.validate(StudioConfig, {"environment": "lab", field: name})
        )
        for field in components.families(StudioConfig)
        if field != "policy"
    },
}


def called(node: ast.Call) -> str:
    """The last name of what is called."""
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def test_who_trusts_is_listed():
    """By ``typed=``, or by an argument in its place."""

    def trusts(node: ast.Call) -> bool:
        by_name = any(keyword.arg == "typed" for keyword in node.keywords)
        return by_name or (called(node) == "validate" and len(node.args) > 4) or called(node) == "Origin"

    assert callers(trusts) == TYPED.keys()


def test_nobody_else_makes_options_of_what_others_wrote():
    """Options made in Python are typed by the user, so the package itself makes none of values that it got."""
    classes = {model.__name__ for model in (*COMMANDS.values(), ScenarioConfig, config.EnvConfig, config.OwnPart)}
    parts = set().union(*(components.families(model) for model in COMMANDS.values()))

    def makes(node: ast.Call) -> bool:
        name, given = called(node), {keyword.arg for keyword in node.keywords}
        if name in classes:
            return None in given or name == "OwnPart"
        of_options = isinstance(node.func, ast.Attribute) and ast.unparse(node.func.value) in OPTIONS
        changes_parts = None in given or bool(given & parts)
        return name.startswith(("model_validate", "model_construct")) or (
            name == "replace" and of_options and changes_parts
        )

    assert callers(makes) == MADE.keys()


@pytest.mark.parametrize("way", WAYS)
def test_nothing_runs_unless_its_words_were_typed(way, tmp_path):
    """The part raises an error as soon as it is read, so a run would show."""
    (tmp_path / "evil.py").write_text("raise SystemExit('it ran')\n")
    with pytest.raises(InputError, match=r"evil.py:go is code, and a file or message names it, not you"):
        WAYS[way](f"{tmp_path}/evil.py:go")


def test_a_law_of_a_file_is_a_file_of_constants(tmp_path, monkeypatch):
    """Also if it is called like code."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text("raise SystemExit('it ran')\n")
    (tmp_path / "evil.py:go").write_text("preset: nothing\n")
    with pytest.raises(InputError, match="evil.py:go"):
        making.plan_scenario(registry.with_law(config.EnvConfig(environment="lab"), "evil.py:go"))


@pytest.mark.parametrize(
    "words", ["callbacks: [mine.py:log]", "callbacks: mine.py:log", "callbacks: {log: mine.py:log}"]
)
def test_callbacks_of_a_file_are_called_if_they_are_trusted(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("def log(line): pass\n")
    (tmp_path / "config.yaml").write_text(f"environment: lab\n{words}\n")
    given = flags.parse("train", PPOConfig, ["ppo", "--config", "config.yaml"], configurable=True)
    options = command_line._read(PPOConfig, given)
    with pytest.raises(InputError, match=r"callbacks: mine.py:log is code, and config.yaml names it"):
        reinforcement._callbacks(options)
    with user_parts.trust():
        (function,) = reinforcement._callbacks(options)
    assert function.__name__ == "log"


def test_a_part_stays_typed_in_copies_alone():
    """What is written and read again is a file's."""
    mine = RunConfig(policy="mine.py:go").replace(people=3)
    assert mine.policy.is_typed and mine.model_copy().policy.is_typed
    again = config.validate(RunConfig, yaml.safe_load(yaml.safe_dump(mine.identity())))
    assert again.policy.kind == "mine.py:go" and not again.policy.is_typed


@pytest.mark.parametrize("text", ["-" * 9000 + "1", "1" + "+1" * 9000, "x" + "[0]" * 9000, "(" * 9000, "0x"])
def test_code_that_no_parser_takes_is_only_read(text, tmp_path):
    """Python's own parser has no bounds of its own: its errors are those of an execution, which does not happen."""
    (tmp_path / "deep.py").write_text(f"x={text}\n")
    digest = hashlib.sha256((tmp_path / "deep.py").read_bytes()).hexdigest()
    (tmp_path / "config.yaml").write_text(f"config: {{policy: 'deep.py:act'}}\nsha256: {{deep.py: {digest}}}\n")
    read_config(tmp_path / "config.yaml")
    with pytest.raises(InputError, match="deep.py:act is code"):
        user_parts.check_trust(config.validate(RunConfig, {"policy": f"{tmp_path}/deep.py:act"}))
    with user_parts.trust(), pytest.raises(InputError, match="deep.py cannot be imported"):
        part = config.validate(config.OwnPart, {"kind": f"{tmp_path}/deep.py:act"})
        user_parts.load(part, "policy")


def test_code_is_parsed_if_it_is_that_of_its_digest_and_short(tmp_path, monkeypatch):
    def parse(text):
        raise AssertionError("it is parsed")

    (tmp_path / "mine.py").write_text("import other\n")
    (tmp_path / "config.yaml").write_text("config: {policy: 'mine.py:act'}\nsha256: {mine.py: abc}\n")
    monkeypatch.setattr(user_parts.ast, "parse", parse)
    with pytest.raises(InputError, match=r"mine.py: is not the file that \S+ was made with"):
        read_config(tmp_path / "config.yaml")
    (tmp_path / "mine.py").write_text("a;" * user_parts.MAX_CODE)
    with pytest.raises(FileError, match="at most 500,000 are read"):
        user_parts.content(tmp_path / "mine.py")


@pytest.mark.parametrize("host", ["0.0.0.0", "[::]", "192.168.0.7", "127.0.0.1", "localhost", "[::1]", ""])
@pytest.mark.parametrize("command", ["run", "bridge"])
def test_a_file_opens_no_port_to_other_computers(command, host, tmp_path):
    model = COMMANDS[command]
    place = f"{host}:9555"
    written = {"run": f"policy: 'rosbridge:{place}'", "bridge": f"rosbridge: true\naddress: '{place}'"}
    typed = {"run": ["--policy", f"rosbridge:{place}"], "bridge": ["--address", place]}
    (tmp_path / "config.yaml").write_text(f"environment: lab\n{written[command]}\n")
    words = ["--config", str(tmp_path / "config.yaml")]

    def read(*more):
        return command_line._read(model, flags.parse(command, model, [*words, *more], configurable=True))

    if host in ("127.0.0.1", "localhost", "[::1]", ""):
        assert place in str(read().identity() if command == "run" else read().address)
        return
    with pytest.raises(InputError, match=r"config.yaml opens \S+ to other computers, and you did not; type --"):
        read()
    read(*typed[command])
    with user_parts.trust():
        read()
