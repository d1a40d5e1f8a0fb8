"""Table I of recordings: everybody in turn as the robot, against a loop in double precision; resamples; the report."""

import math

import numpy as np
import pytest

from sean_jax.classifiers import MORE_SITUATIONS, OBJECT_SITUATIONS, SITUATIONS
from sean_jax.cli import command_line
from sean_jax.config import Table1Config
from sean_jax.core.errors import FileError
from sean_jax.metrics import bootstrap
from sean_jax.studies.experiments import shares, table1
from sean_jax.studies.experiments.results_table import ALL, Table

STEP = 0.4  # s
SPEEDS = (1.4, 1.0, 0.4)
# start [m], velocity [m/s], first and last row of each person
WALKS = [
    ((0.0, 0.0), (1.1, 0.0), 0, 12),
    ((0.5, 0.7), (1.2, 0.05), 0, 12),
    ((3.0, -4.0), (0.1, 1.6), 0, 14),
    ((6.0, 0.3), (-0.5, 0.0), 2, 20),
    ((-3.0, 6.0), (1.3, -1.4), 3, 9),
]


def known(table: Table) -> set[str]:
    """The situations that a recording can have."""
    finite = Table(table.columns, table.names, np.isfinite(table.value).astype(float))
    return {name for (name,), rows in finite.groups(["situation"]).items() if rows.value.all()} - {shares.NONE, ALL}


def where(person: int, row: int) -> np.ndarray:
    start, velocity, _, _ = WALKS[person]
    return np.add(start, np.multiply(velocity, row * STEP))


def recording(path, groups=False):
    lines = ["frame,ped_id,x_m,y_m" + (",group_id" if groups else "")]
    for person, (_, _, first, last) in enumerate(WALKS):
        for row in range(first, last + 1):
            x, y = where(person, row)
            group = f",{7 if person < 2 else -1}" if groups else ""
            lines.append(f"{row},{person + 3},{x:.6f},{y:.6f}{group}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def by_hand(robot: int, row: int, speed: float, leave=frozenset()) -> list[bool]:
    """Cross path, down path, join group, leave group and empty, of equations (1), (2) and (5)."""
    own, values = WALKS[robot][1], [False, False, False, False, True]
    for other, (_, velocity, first, last) in enumerate(WALKS):
        if (
            other == robot
            or other in leave
            or not first <= row <= last
            or math.dist(where(robot, row), where(other, row)) >= 2.4
        ):
            continue
        values[4] = False
        turn = math.degrees(math.atan2(own[1], own[0]) - math.atan2(velocity[1], velocity[0]))
        turn = abs((turn + 180) % 360 - 180)
        values[0] |= math.hypot(*velocity) > speed and 75 <= turn <= 105
        values[1] |= turn <= 15
    return values


def test_everybody_plays_the_robot(tmp_path):
    people = shares.read_recordings([str(recording(tmp_path / "walk.csv"))], 1 / STEP)["walk"]
    told = []
    person, flags, more = shares._examples(people, SPEEDS, told.append, "paper")
    assert told == [0.2, 0.4, 0.6, 0.8, 1.0]
    rows = [(robot, row) for robot, (_, _, first, last) in enumerate(WALKS) for row in range(first, last + 1)]
    assert person.tolist() == [robot for robot, _ in rows]
    expected = [[by_hand(*each, speed) for each in rows] for speed in SPEEDS]
    np.testing.assert_array_equal(flags, expected)
    assert flags[0].any(0).tolist() == [True, True, False, False, True]
    assert flags[0, :, 0].sum() < flags[2, :, 0].sum(), "a lower V makes more of them walk"
    found = shares.count_recording("walk", people, SPEEDS)
    assert known(found) == {*SITUATIONS, *MORE_SITUATIONS} - {*OBJECT_SITUATIONS, "join_group", "leave_group"}
    assert found.levels("people") == [5] and found.levels("episode") == [0, 1, 2, 3, 4]
    names = list(MORE_SITUATIONS)
    assert not more[:, [names.index(name) for name in OBJECT_SITUATIONS]].any()
    # 2 cannot but touch who is in its way: straight on, within 3 s.
    ends = {"collision_course": 3.0, "hurrying": 0.0}
    for robot, row in rows:
        apart = []
        for other, (_, velocity, first, last) in enumerate(WALKS):
            if other != robot and first <= row <= last:
                times = np.linspace(0.0, ends["collision_course"], 3001)[:, None]
                relative = np.subtract(velocity, WALKS[robot][1])
                way = where(other, row) - where(robot, row) + times * relative
                apart.append(np.linalg.norm(way, axis=1).min())
        flag = more[rows.index((robot, row)), names.index("collision_course")]
        assert flag == (min(apart, default=9.0) < 0.4), (robot, row)
        hurry = any(
            math.hypot(*WALKS[k][1]) > 1.86
            and 0 < np.dot(where(robot, row) - where(k, row), WALKS[k][1]) / math.hypot(*WALKS[k][1]) < 3.6
            and abs(np.cross([*(where(robot, row) - where(k, row)), 0], [*WALKS[k][1], 0])[2])
            / math.hypot(*WALKS[k][1])
            < 1.2
            for k, (_, _, first, last) in enumerate(WALKS)
            if k != robot and first <= row <= last
        )
        assert more[rows.index((robot, row)), names.index("hurrying")] == hurry
    assert more[:, names.index("collision_course")].any() and more[:, names.index("hurrying")].any()


def test_groups_are_told_where_they_are_annotated(tmp_path):
    people = shares.read_recordings([str(recording(tmp_path / "walk.csv", groups=True))], 1 / STEP)["walk"]
    found = shares.count_recording("walk", people, SPEEDS)
    assert {"join_group", "leave_group"} <= known(found)
    assert found.where(situation="join_group", speed="1.4").value.any()


def test_companions_are_not_met(tmp_path):
    """Of four in two lines that share somebody; what others meet stays."""
    path = recording(tmp_path / "walk.csv")
    path.with_suffix(".groups.txt").write_text(" 3 4\n\n 5\n6 4\n", encoding="utf-8")
    read = shares.read_recordings([str(path)], 1 / STEP)
    assert list(read) == ["walk", "walk without companions"]
    assert read["walk without companions"].companions.tolist() == [0, 0, -1, 0, -1]
    whole, without = (shares._examples(people, (1.0,), lambda _: None, "paper") for people in read.values())
    rows = [(robot, row) for robot, (_, _, first, last) in enumerate(WALKS) for row in range(first, last + 1)]
    together = {0, 1, 3}
    expected = [by_hand(*each, 1.0, leave=together if each[0] in together else set()) for each in rows]
    np.testing.assert_array_equal(without[1][0], expected)
    apart = ~np.isin(whole[0], list(together))
    np.testing.assert_array_equal(without[2][apart], whole[2][apart])
    assert without[1][0, :, 4].sum() > whole[1][0, :, 4].sum()
    for number in ("9", "9" * 5000):
        path.with_suffix(".groups.txt").write_text(f"3 4\n5 {number}\n", encoding="utf-8")
        with pytest.raises(FileError, match=r"walk.groups.txt:2: '9+' is the number of nobody in the recording"):
            shares.read_recordings([str(path)], 1 / STEP)


def test_sean2_has_its_own_directions(tmp_path):
    """Who comes against the robot is in down path by SEAN's code, and not as printed."""
    people = shares.read_recordings([str(recording(tmp_path / "walk.csv"))], 1 / STEP)["walk"]
    printed, coded = (shares._examples(people, (0.4,), lambda _: None, kind) for kind in ("paper", "sean2"))
    assert (coded[1][0, :, 1] & ~printed[1][0, :, 1]).any()
    np.testing.assert_array_equal(coded[2], printed[2])


def test_resamples_take_people_with_all_their_examples():
    random = np.random.default_rng(0)
    person = np.repeat([4, 9, 2, 7], [3, 11, 1, 6])
    flags = random.random((21, 5)) < 0.4
    table = shares.people_rows(flags, shares.FIVE, person)
    (found,) = shares.people_shares(table, [], seed=3).values()
    np.testing.assert_allclose(found[0, :5], flags.mean(0))
    assert found[0, 5] == pytest.approx((~flags.any(1)).mean()) and table.where(situation=ALL).value.sum() == 21
    weights = bootstrap.resamples(4, 3, bootstrap.RESAMPLES)
    for row in range(0, 2000, 97):
        times = {name: int(n) for name, n in zip(sorted({2, 4, 7, 9}), weights[row], strict=True)}
        drawn = np.concatenate([flags[person == name] for name, n in times.items() for _ in range(n)])
        np.testing.assert_allclose(found[1 + row, :5], drawn.mean(0))
        assert found[1 + row, 5] == pytest.approx((~drawn.any(1)).mean())
    blocks = flags[:20].reshape(1, 4, 5, 5)  # of people with equally many examples
    chains = shares.chain_rows(blocks, blocks[0], np.array([1, 0]), 1, [""])
    (whole,) = shares.chain_shares(chains, [], draw=lambda _: bootstrap.resamples(4, 3, 2000)).values()
    people = shares.people_rows(flags[:20], shares.FIVE, np.repeat(range(4), 5))
    (same,) = shares.people_shares(people, [], seed=3).values()
    np.testing.assert_allclose(whole, same)
    np.testing.assert_allclose(*(shares.counted(values, "flags_and_none") for values in (whole, same)))


def test_recordings_alone(tmp_path):
    """Without anybody who drives: shares.csv is empty, and the report has the recordings."""
    walk, pairs = recording(tmp_path / "walk.csv"), recording(tmp_path / "pairs.csv", groups=True)
    out = tmp_path / "out"
    given = ["experiment", "table1", "--policies", "none", "--recordings", f"{walk},{pairs}", "--frame-rate", "2.5"]
    assert command_line.main([*given, "--quiet", "--out", str(out), "--speeds", *map(str, SPEEDS)]) == 0
    rows = [line.split(",") for line in (out / "recordings.csv").read_text(encoding="utf-8").splitlines()]
    assert rows[0] == ["recording", "people", "V", "counting", "situation", "share", "low", "high"]
    read = shares.read_recordings([str(walk)], 1 / STEP)["walk"]
    occurring = known(shares.count_recording("walk", read, SPEEDS))
    _, flags_by_speed, more = shares._examples(read, SPEEDS, lambda _: None, "paper")
    for speed, flags in zip(SPEEDS, flags_by_speed, strict=True):
        for k, name in enumerate(SITUATIONS):
            share = {
                row[3]: float(row[5]) for row in rows if row[0] == "walk" and row[2] == f"{speed:g}" and row[4] == name
            }
            if name not in occurring:
                assert not share
                continue
            whole = {"flags": flags.sum(), "examples": len(flags), "situated_examples": flags.any(1).sum()}
            whole["flags_and_none"] = whole["flags"] + len(flags) - whole["situated_examples"]
            assert share == {key: pytest.approx(flags[:, k].sum() / value, abs=1e-5) for key, value in whole.items()}
    further = {row[4]: row for row in rows if row[0] == "walk" and not row[2]}
    assert set(further) == occurring & set(MORE_SITUATIONS)
    for name, row in further.items():
        low, share, high = float(row[6]), float(row[5]), float(row[7])
        there = more[:, list(MORE_SITUATIONS).index(name)].mean()
        assert low <= share <= high and share == pytest.approx(there, abs=1e-5)
    assert {row[4] for row in rows[1:] if row[0] == "pairs"} >= {"join_group", "leave_group"}
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "walk, V = 1.4 m/s" in text and "collision course" in text and "Orderings" not in text
    assert len((out / "shares.csv").read_text(encoding="utf-8").splitlines()) == 1 and not list(out.glob("*.npz"))
    assert command_line.main([*given, "--quiet", "--out", str(out), "--speeds", *map(str, SPEEDS)]) == 0, "again"


def test_what_cannot_be_read_is_refused_before_anything_is_written(tmp_path):
    options = Table1Config(policies="none", recordings=str(tmp_path / "none.csv"), out=tmp_path / "o")
    with pytest.raises(FileError, match=r"none.csv.*no such file"):
        table1.run_table1(options)
    with pytest.raises(ValueError, match="does not tell how many frames a second"):
        table1.run_table1(options.replace(recordings=str(recording(tmp_path / "walk.csv"))))
    with pytest.raises(ValueError, match="--policies: 'none' is not one of"):
        table1.run_table1(options.replace(recordings=None))
    assert not (tmp_path / "o").exists()


def test_recordings_of_one_name_keep_their_paths(tmp_path):
    paths = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        paths.append(str(recording(tmp_path / folder / "walk.csv")))
    assert list(shares.read_recordings([*paths, str(recording(tmp_path / "x.csv"))], 2.5)) == [*paths, "x"]


def test_shares_of_people_recorded_in_zurich_and_nicosia(request):
    """The figures of docs/situations.md."""
    folder = request.getfixturevalue("recordings") / "eth_ucy"
    for name, people, down, empty in (("eth", 360, 0.714, 0.284), ("zara01", 148, 0.802, 0.197)):
        people_there = shares.read_recordings([str(folder / f"{name}.csv")])[name]
        found = shares.count_recording(name, people_there, (1.4, 0.4))
        share = np.nan_to_num(shares.counted(shares.people_shares(found, ["speed"])["1.4",]))[0]
        assert found.levels("people") == [people] and share.sum() == pytest.approx(1.0)
        assert found.levels("behavior") == [name]
        np.testing.assert_allclose(share[[1, 4]], [down, empty], atol=5e-4)
