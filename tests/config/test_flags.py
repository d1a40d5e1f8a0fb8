"""Words of the command line: ``key=value`` beside flags, and files of options for each command that takes them."""

from pathlib import Path

import pytest
import yaml

from sean_jax.cli import command_line
from sean_jax.config import COMMANDS, CustomTask, GraphBehavior, Named, RunConfig, flags
from sean_jax.core.errors import InputError

SCENARIO = ["run", "collect", "train ppo", "train apg", "studio", "bridge"]
TRANSPORT = {"bridge": ["--dds"]}


def options_of(words: str, arguments: list[str]):
    """The options of a command line."""
    word, *method = words.split()
    model = COMMANDS[words]
    parsed = flags.parse(words, model, [*method, *TRANSPORT.get(word, ()), *arguments], configurable=True, trust=True)
    return command_line._read(model, parsed)


@pytest.mark.parametrize("words", SCENARIO)
@pytest.mark.parametrize(
    ("assignments", "typed"),
    [
        ("people=8 robot=jackal", "--people 8 --robot jackal"),
        ("time_limit=20 time-step=0.2 seed=3", "--time-limit 20 --time-step 0.2 --seed 3"),
        ("task_distance=4,inf behavior=graph routing=edge", "--task-distance 4 inf --behavior graph --routing edge"),
        ("walking_groups=[0.3,0.2] --forces sean2", "--walking-groups 0.3 0.2 --forces sean2"),
        (
            "task=[join_group,leave_group] situations=[paper,my.py:f]",
            "--situations paper --situation my.py:f --task join_group,leave_group",
        ),
        ("environment=lab --hold-time 2 goal_radius=1", "--environment lab --hold-time 2 --goal-radius 1"),
        ("task=join_group,leave_group situations=paper,my.py:f", "--task join_group,leave_group --situation my.py:f"),
    ],
)
def test_a_key_with_a_value_is_a_flag(words, assignments, typed):
    assert options_of(words, assignments.split()) == options_of(words, typed.split())


@pytest.mark.parametrize(
    ("assignment", "field", "value"),
    [
        ("time_step=.5", "time_step", 0.5),
        ("people=08", "people", 8),
        ("people=~", "people", None),
        ("live=true", "live", True),
        ("thresholds={walking: 0.3}", "thresholds", {"walking": 0.3}),
        ('thresholds={"walking":0.3}', "thresholds", {"walking": 0.3}),
        ("task_distance=[4, .inf]", "task_distance", (4.0, float("inf"))),
        ("behavior={kind: graph, routing: edge}", "behavior", GraphBehavior(routing="edge")),
        ("task={kind: custom, start: [1, 2]}", "task", (CustomTask(start=(1, 2)),)),
        ("forces=[sean2]", "forces", (Named(kind="sean2"),)),
        ("name={a: b}", "name", "{a: b}"),
    ],
)
def test_a_value_of_a_key_is_that_of_a_line_of_a_file(assignment, field, value):
    """A number as YAML writes it; a text stays a text."""
    assert getattr(options_of("run", [assignment]), field) == value


def test_words_after_a_flag_of_several_values_are_its_values():
    typed = options_of("train ppo", "recurrent=true --sweep clip=0.1,0.2 entropy=0.1 --people 8".split())
    assert typed.sweep == ("clip=0.1,0.2", "entropy=0.1") and typed.recurrent
    assert options_of("train ppo", ["sweep=clip=0.1,0.2 entropy=0.1", "people=8", "recurrent=True"]) == typed
    assert options_of("train ppo", "--rewards progress=2,time=-0.2 layers=3".split()).layers == 3
    assert options_of("train ppo", ["action_delay=0,2"]).action_delay == (0, 2)


@pytest.mark.parametrize("words", SCENARIO)
def test_words_override_a_file(words, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    content = {"people": 4, "environment": "lab", "behavior": {"kind": "graph", "routing": "edge"}, "seed": 5}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(content))
    options = options_of(words, "--config mine.yaml people=8 --time-limit 30".split())
    assert (options.people, options.environment, options.seed, options.time_limit) == (8, "lab", 5, 30.0)
    assert options.behavior.routing == "edge"


@pytest.mark.parametrize("words", [words for words in SCENARIO if words != "run"])
def test_other_commands_take_the_scenario_of_a_run(words, capsys, monkeypatch, tmp_path):
    """Not its policy and seed, which each command has itself."""
    monkeypatch.chdir(tmp_path)
    scenario = {"environment": "lab", "behavior": {"kind": "random"}, "time_limit": 20.0, "warm_up": 0.0}
    run = RunConfig(**scenario, people=4, policy="expert", episodes=3, seed=5)
    description = {name: value for name, value in run.identity().items() if value is not None}
    content = {"command": flags.command("run", run), "config": description}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(content, sort_keys=False))

    options = options_of(words, "--config config.yaml people=8".split())
    assert options.identity() == options_of(words, []).replace(**scenario, people=8).identity()
    left = "metrics, policy, episodes, seed, batch" if words == "collect" else "policy, episodes, seed, batch"
    note = f"note: config.yaml is of a run; its scenario is taken, without {left}.\n"
    assert capsys.readouterr().out == note
    if "quiet" in COMMANDS[words].model_fields:
        options_of(words, "--config config.yaml --quiet".split())
        assert not capsys.readouterr().out

    (tmp_path / "config.yaml").write_text("environment: lab\ntrajectories: csv\n")  # of the user's own
    with pytest.raises(InputError, match="config.yaml: 'trajectories' is not a known key"):
        options_of(words, "--config config.yaml".split())


def test_false_turns_a_switch_of_a_file_off(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text("live: true\n")
    assert options_of("run", ["--config", "mine.yaml"]).live
    assert options_of("run", ["--config", "mine.yaml", "live=true"]).live
    assert not options_of("run", ["--config", "mine.yaml", "live=false"]).live
    assert not options_of("run", ["live=false"]).live

    (tmp_path / "mine.yaml").write_text("rosbridge: true\n")
    assert options_of("bridge", ["--config", "mine.yaml", "rosbridge=false"]).dds


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("run peple=8", "peple: there is no such option; did you mean 'people'?"),
        ("run num_people=8", "num_people: there is no such option; did you mean 'people'?"),
        ("run zzzzzz=8", "zzzzzz: there is no such option; `sean run --help` lists the options."),
        ("run people=", "people is an empty text; give a value, or leave the option out for its default."),
        ("run =8", "=8 has no key; write key=value, such as people=8."),
        ("run behavior.routing=edge", "behavior.routing: there is no such option; did you mean 'routing'?"),
        ("run people=8 people=9", "people: the key is given twice; leave one of the two out."),
        ("run time-limit=8 time_limit=9", "time_limit: the key is given twice; leave one of the two out."),
        ("run --people 8 people=9", "people: --people is given as well; leave one of the two out."),
        ("run live=false --live", "live: --live is given as well; leave one of the two out."),
        ("run --config a.yaml --config=b.yaml", "--config is repeated; give one file, and other values as flags."),
        ("run --live=false", "--live=false: a switch has no value; write --live alone, or leave it out."),
        ("train ppo zzzzzz=8", "zzzzzz: there is no such option; `sean train ppo --help` lists the options."),
        ("run live=maybe", "--live: 'maybe' is not true or false."),
        ("run people='8'", "--people: '8' is not a whole number."),
        ("run people=-1", "--people: -1 must be from 0 to"),
        ("collect dynamics=twinn", "--dynamics: 'twinn' is not one of twin, mjx, kinematic; did you mean 'twin'?"),
    ],
)
def test_a_wrong_key_or_value_is_refused_in_a_sentence(words, sentence):
    word = next(word for word in SCENARIO if words.startswith(word))
    with pytest.raises(InputError) as caught:
        options_of(word, words.removeprefix(word).split())
    assert str(caught.value).startswith(sentence)


def test_only_words_that_are_no_options_are_named(capsys):
    """Not the keys beside them."""
    with pytest.raises(SystemExit):
        options_of("run", ["seed=1", "two"])
    told = capsys.readouterr().err
    assert "Unrecognized options: two" in told and "seed=1" not in told


@pytest.mark.parametrize(
    ("content", "words", "sentence"),
    [
        ("people: 90000", "", "mine.yaml: people: 90000 do not fit"),
        ("people: 90000", "environment=lab", "mine.yaml: people: 90000 do not fit"),
        ("environment: warehose", "", "mine.yaml: environment 'warehose' is not one of"),
        ("environment: warehose", "environment=lap", "environment 'lap' is not one of"),
        ("behavior: {kind: grph}", "", "mine.yaml: behavior: 'grph' is not one of"),
        ("behavior: {kind: playback, recording: no.csv}", "", "mine.yaml: recording: no.csv does not exist"),
        ("thresholds: {walkin: 3}", "", "mine.yaml: thresholds: 'walkin' is not one of"),
        ("seed: 3", "people=90000", "people: 90000 do not fit"),
        ("out: ''", "", "mine.yaml: out is an empty text; give a value"),
        ("routing: edge", "", "mine.yaml: 'routing' is not a known key; write it into behavior, as behavior: {"),
        ("start: [1, 2]", "", "mine.yaml: 'start' is not a known key; write it into task, as task: {kind: custom"),
        ("config: {people: 3}\nseed: 4", "", "mine.yaml: seed: stands beside config, where nothing reads it; write"),
        ("config: {people: 3}\nsha256: {a.xml: ab}", "", "mine.yaml: a.xml is missing; restore it, and keep"),
        ("command: sean train ppo\nmethod: ppo", "", "mine.yaml: records a command and is no file of options; repeat"),
        ("sensors: depth", "--sensor no.py:f", "sensors: "),
        ("people = 3", "", "mine.yaml: holds no description; write key: value lines, such as people: 8."),
    ],
)
def test_a_wrong_file_is_named(content, words, sentence, capsys, monkeypatch, tmp_path):
    """Also where only the scenario shows that a value is wrong; a value of a word is not the file's."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text(f"{content}\n")
    assert command_line.main(["run", "--config", "mine.yaml", *words.split()]) == 2
    assert capsys.readouterr().err.startswith(f"sean: {sentence}")


def test_paths_in_a_file_are_beside_it_or_from_here(monkeypatch, tmp_path):
    """As its code is; a name stays a name, although a folder beside the file has it."""
    monkeypatch.chdir(tmp_path)
    for name in ("mine/floors/hall", "mine/expert", "there"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "mine" / "forces.yaml").touch()
    content = {"environment": "floors/hall", "forces": ["forces.yaml"], "policy": "expert", "out": "floors/hall"}
    (tmp_path / "mine" / "mine.yaml").write_text(yaml.safe_dump(content))
    options = options_of("run", ["--config", "mine/mine.yaml"])
    assert (options.environment, options.forces[0].kind) == ("mine/floors/hall", "mine/forces.yaml")
    assert (options.policy.kind, str(options.out)) == ("expert", "floors/hall")

    (tmp_path / "mine" / "mine.yaml").write_text("environment: ./there\nlaws: calibrated,forces.yaml\n")
    options = options_of("train ppo", ["--config", "mine/mine.yaml"])
    assert (options.environment, options.laws) == ("./there", "calibrated,mine/forces.yaml")


def test_a_folder_to_write_may_be_in_that_of_the_user(monkeypatch, tmp_path):
    """Not in one with the name ~, which no shell replaces here."""
    monkeypatch.setenv("HOME", str(tmp_path))
    assert options_of("run", ["--out=~/mine"]).out == options_of("train ppo", ["out=~/mine"]).out == tmp_path / "mine"
    assert options_of("studio", ["record=~nobody-here/mine"]).record == Path("~nobody-here/mine")


def test_commands_with_paths_take_no_keys():
    """A folder may be called seed=1."""
    parsed = flags.parse("compare", COMMANDS["compare"], ["seed=1", "seed=2"])
    assert [path.name for path in parsed["runs"]] == ["seed=1", "seed=2"]
    parsed = flags.parse("train", COMMANDS["train imitation"], ["imitation", "seed=1"], configurable=True)
    assert parsed["dataset"].name == "seed=1" and "seed" not in parsed
    with pytest.raises(SystemExit):
        flags.parse("train", COMMANDS["train imitation"], ["imitation", "data", "seed=1"], configurable=True)
