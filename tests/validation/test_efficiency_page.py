"""What is said of gradients follows their numbers; what was measured is kept; bad input is one line."""

import dataclasses
import json
import math
from pathlib import Path

import pytest

from datasets.command_line import run
from datasets.errors import InputError
from validation.bench.columns.paper import read_paper
from validation.bench.efficiency import __main__ as efficiency
from validation.bench.efficiency import kept, scene_run
from validation.bench.efficiency.crossing import crossing, leaders, points_said, race_said, unknowns_said
from validation.bench.efficiency.cuts import AD, AGAIN, FD_GNS, FD_MPM
from validation.bench.efficiency.kept import Parts
from validation.bench.efficiency.page import page
from validation.bench.efficiency.pictures import draw_points, draw_race, draw_unknowns
from validation.bench.efficiency.rows import Cost, Gradient, Made, OverPoints, OverUnknowns, Race, Row, Shown

MADE = Made(command="python -m validation.bench.efficiency --only x", machine="a machine", date="2000-01-01", key="k")
COMMAND = "python -m validation.bench.efficiency"


def row(method: str, *curve: tuple[float, float], ended: str = "by itself", backward: float = 2.0) -> Row:
    return Row(
        method=method,
        optimiser="adam",
        forward=1.0,
        backward=backward,
        paper=None,
        iterations=4,
        allowed=30,
        ended=ended,
        mpm_runs=0,
        seconds=curve[-1][0],
        error={"m/s": 0.1},
        curve=tuple(Shown(seconds=seconds, loss=loss) for seconds, loss in curve),
    )


def race(*rows: Row, problem: str = "friction-tall-42", key: str = "k") -> Race:
    return Race(
        made=dataclasses.replace(MADE, key=key),
        problem=problem,
        start="friction_deg = 30",
        rule="a loss below 1e-7",
        limit=40.0,
        floor=1e-6,
        rows=rows,
    )


def gradient(method: str, unknowns: int, seconds: float, columns: int | None = None) -> Gradient:
    cosine = None if method == FD_MPM else {AD: 0.91, AGAIN: 0.99}.get(method, 0.9)
    return Gradient(
        method=method,
        unknowns=unknowns,
        seconds=seconds,
        columns=columns or unknowns,
        cosine=cosine,
        error=None if cosine is None else 0.2,
    )


def over_unknowns(ad: float = 10.0, mpm: float = 1.0) -> OverUnknowns:
    """AD at a constant price, the MPM's differences at one for each unknown."""
    found = [gradient(AD, number, ad) for number in (1, 10, 100)]
    found += [gradient(FD_GNS, number, 20.0 * number, min(number, 10)) for number in (1, 10, 100)]
    found += [gradient(FD_MPM, number, mpm * number, min(number, 10)) for number in (1, 10, 100)]
    found += [gradient(AGAIN, number, mpm * number, min(number, 10)) for number in (1, 10, 100)]
    return OverUnknowns(made=MADE, points=3_920, steps={"1": 0.15, "100": 0.5}, gradients=tuple(found))


def over_points(ad: float = 1.0) -> OverPoints:
    """AD's seconds grow with the points, the MPM's with their 1.5th power."""
    return OverPoints(
        made=MADE,
        costs=tuple(
            Cost(
                method=method,
                points=points,
                followed=points,
                unknowns=unknowns,
                seconds=seconds,
                memory=10**9,
                measured="10 steps" if points == 100_000 else "",
            )
            for points in (1_000, 10_000, 100_000)
            for unknowns in (1, 10)
            for method, seconds in (
                (AD, ad * points / 1_000.0),
                (FD_GNS, 10.0 * unknowns * points / 1_000.0),
                (FD_MPM, 0.1 * unknowns * (points / 1_000.0) ** 1.5),
            )
        ),
    )


def test_a_crossing_is_found_where_it_was_put() -> None:
    flat, rising = [(1.0, 20.0), (10.0, 20.0), (100.0, 20.0)], [(1.0, 2.0), (10.0, 8.0), (100.0, 50.0)]
    found = crossing(flat, rising)
    # On logarithmic axes between 10 and 100: 8 (n / 10)^a = 20 with 8 10^a = 50.
    assert found.first == pytest.approx(10.0 * (20.0 / 8.0) ** (1.0 / math.log10(50.0 / 8.0)), rel=1e-9)
    assert not found.everywhere
    assert crossing(rising, flat).never
    assert crossing([(1.0, 1.0), (100.0, 1.0)], rising).everywhere
    # What falls behind again has not won.
    assert crossing([(1.0, 3.0), (10.0, 1.0), (100.0, 60.0)], rising).never


def test_what_is_said_of_unknowns_follows_the_numbers() -> None:
    text = " ".join(unknowns_said(over_unknowns().gradients))
    assert f"{AD} is cheaper than {FD_MPM} from about 10 unknowns on" in text
    assert f"{AD} is cheaper than {FD_GNS} at every number of unknowns from 1 to 100" in text
    assert "takes 10 % of the seconds" in text
    assert "0.910 at 100 unknowns (two jitters of the MPM: 0.990)" in text
    dear = " ".join(unknowns_said(over_unknowns(ad=1_000.0).gradients))
    assert f"{AD} is not cheaper than {FD_MPM} at any number of unknowns up to 100" in dear


def test_what_is_said_of_points_follows_the_numbers() -> None:
    # 1 n = 0.1 n^1.5 at n = 100 thousand, with ten unknowns from the first on; equal there is not cheaper.
    text = " ".join(points_said(over_points(ad=0.5).costs))
    assert f"With 1 unknown: {AD} is cheaper than {FD_MPM} from about 25,000 points on" in text
    assert f"With 10 unknowns: {AD} is cheaper than {FD_MPM} at every number of points from 1,000 to 100,000" in text
    dear = " ".join(points_said(over_points(ad=50.0).costs))
    assert f"With 1 unknown: {AD} is not cheaper than {FD_MPM} at any number of points" in dear


def test_the_winner_is_who_the_mpm_says() -> None:
    slow, fast = row("AD, GNS", (3.0, 1e-2), (30.0, 1e-3)), row("differences, our MPM", (1.0, 2e-2), (9.0, 1e-5))
    text = " ".join(race_said(race(slow, fast)))
    assert "least loss in the MPM 1.0e-05 by differences, our MPM" in text
    assert "First within 1.5 times the greater of the two: differences, our MPM, after 9 s" in text
    assert "AD, GNS stays at 1.0e-03, 1e+02 times the least" in text
    # Below the scatter all are as good, and the first there wins.
    soon = row("AD, GNS", (2.0, 1.2e-6))
    text = " ".join(race_said(race(soon, row("differences, our MPM", (5.0, 2e-7)))))
    assert "by differences, our MPM" in text
    assert "two: AD, GNS, after 2 s" in text
    assert "stays at" not in text
    assert leaders(race(slow, fast), (0.5, 2.0, 5.0, 10.0)) == {
        0.5: None,
        2.0: ("differences, our MPM", 2e-2),
        5.0: ("AD, GNS", 1e-2),
        10.0: ("differences, our MPM", 1e-5),
    }


def test_what_was_multiplied_is_marked() -> None:
    rows = (row("AD, GNS", (12.0, 1e-3), ended="out of time"), row("other", (12.0, 1e-3)))
    text = page(Parts(races={"a": race(*rows)}, unknowns=over_unknowns(), points=over_points()), read_paper())
    assert "≈ 90 s for 30" in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert any(line.startswith(f"| 100 | {FD_MPM} | ≈ 100.00 | 10 of 100 |") for line in lines)
    assert any(line.startswith(f"| 10 | {FD_MPM} | 10.00 | all |") for line in lines)
    assert any(line.startswith("| 100,000 |") and "≈" in line and "10 steps" in line for line in lines)
    assert not any(line.startswith("| 1,000 |") and "≈" in line for line in lines)
    assert text.count("a machine") == 3
    assert "A trial" not in text
    trial = dataclasses.replace(race(*rows), made=dataclasses.replace(MADE, quick=True))
    assert "these figures say nothing" in " ".join(page(Parts(races={"a": trial}), read_paper()).split())


def test_pictures_are_drawn(tmp_path: Path) -> None:
    draw_unknowns(tmp_path / "a.png", over_unknowns())
    draw_points(tmp_path / "b.png", over_points())
    draw_race(tmp_path / "c.png", race(row("AD, GNS", (1.0, 0.1), (2.0, 0.01)), row("Optuna, GNS", (1.0, 0.1))))
    assert all((tmp_path / name).stat().st_size > 10_000 for name in ("a.png", "b.png", "c.png"))


def test_parts_come_back_as_they_were_kept(tmp_path: Path) -> None:
    parts = Parts(unknowns=over_unknowns(), points=over_points())
    parts = parts.with_part(race(row("AD, GNS", (1.0, 0.1))))
    kept.write(tmp_path, parts)
    assert kept.read(tmp_path) == parts
    made = parts.made("friction-tall-42")
    assert made is not None
    assert made.key == "k"
    assert parts.made("baffles-2") is None
    assert kept.read(tmp_path / "none") == Parts()


@pytest.mark.parametrize("text", ["{", "[]", '{"race": {}}'])
def test_a_file_that_is_none_of_ours_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / kept.FILE).write_text(text)
    with pytest.raises(InputError) as told:
        kept.read(tmp_path)
    assert kept.FILE in str(told.value)


def test_a_key_follows_the_weights(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"a")
    (tmp_path / "b").write_bytes(b"b")
    assert kept.key([tmp_path / "a"], 1) == kept.key([tmp_path / "a"], 1)
    assert len({kept.key([tmp_path / name], number) for name in "ab" for number in (1, 2)}) == 4
    with pytest.raises(InputError):
        kept.key([tmp_path / "c"])


def test_a_cut_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    def measure(name: str, setup: efficiency.Setup) -> Race:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(name)
        return race(row("AD, GNS", (1.0, 0.1), (2.0, 0.01)), problem=name, key=setup.key)

    drawn: list[str] = []
    monkeypatch.setattr(efficiency, "measure", measure)
    monkeypatch.setattr(efficiency, "draw_race", lambda path, part: drawn.append(f"{path.name} {part.problem}"))
    out = ["--out", str(tmp_path)]
    races = [f"--only={name}" for name in efficiency.LIMITS]
    assert run(efficiency.command, COMMAND, [*out, *races]) == 130
    assert len(json.loads((tmp_path / kept.FILE).read_text())["races"]) == 2
    first = list(done)
    done.clear()
    assert run(efficiency.command, COMMAND, [*out, *races, "--resume"]) == 0
    assert first + done == list(efficiency.LIMITS)
    assert all(f"## {name}" in (tmp_path / "efficiency.md").read_text() for name in efficiency.LIMITS)
    assert drawn == [f"efficiency-{name}.png {name}" for name in efficiency.LIMITS]
    # With other limits nothing that is there counts; without --resume neither, but what is not asked for stays.
    done.clear()
    assert run(efficiency.command, COMMAND, [*out, races[0], "--resume", "--seconds", "3"]) == 0
    assert run(efficiency.command, COMMAND, [*out, races[0]]) == 0
    assert done == ["friction-tall-42"] * 2
    assert set(kept.read(tmp_path).races) == set(efficiency.LIMITS)


@pytest.mark.parametrize(
    ("flags", "word"),
    [
        (["--only", "friction"], "friction-tall-42"),
        (["--seconds", "0"], "--seconds"),
        (["--threads", "0"], "--threads"),
        (["--model", "nowhere.pt"], "nowhere.pt"),
        (["--what"], "--what"),
    ],
)
def test_bad_flags_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: list[str], word: str) -> None:
    assert run(efficiency.command, COMMAND, ["--out", str(tmp_path), *flags]) == 2
    error = capsys.readouterr().err
    assert word in error
    assert len(error.splitlines()) == 1


def test_a_case_of_its_own_takes_sensible_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    name = "python -m validation.bench.efficiency.scene_run"
    assert run(scene_run.command, name, ["ad", "0.5"]) == 2
    assert run(scene_run.command, name, ["mpm", "1", "--runs", "0"]) == 2
    assert "--runs" in capsys.readouterr().err


@pytest.mark.slow
def test_a_trial_for_real(tmp_path: Path) -> None:
    flags = ["--out", str(tmp_path), "--quick", "--only", "friction-tall-42", "--only", "unknowns"]
    assert run(efficiency.command, COMMAND, flags) == 0
    parts = kept.read(tmp_path)
    assert parts.unknowns is not None
    again = [each for each in parts.unknowns.gradients if each.method == AGAIN]
    assert all(each.cosine is not None and each.cosine > 0.9 for each in again)
    by_mpm = [each for each in parts.races["friction-tall-42"].rows if each.method == "differences of 2 deg, our MPM"]
    assert by_mpm[0].loss < by_mpm[0].curve[0].loss
    assert "say nothing" in (tmp_path / "efficiency.md").read_text()
