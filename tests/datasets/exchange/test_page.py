"""The page of a flow: what is in it comes back within its rounding; a browser, where there is one, shows it."""

import base64
import dataclasses
import html
import json
import re
import shutil
import subprocess
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

from datasets import Material, Solid, Trajectory
from datasets.exchange import page as view
from datasets.exchange.page import Observed, write_view
from tests.datasets.conftest import toy
from tests.refusals import refused

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
HOSTILE = "</script><img src=x onerror=alert(1)>"


def parts(page: Path) -> tuple[dict[str, Any], bytes]:
    """What a page holds: its head, and the bytes of its arrays."""
    text = page.read_text(encoding="utf-8")
    script = '<script id="{}" type="[^"]*">(.*?)</script>'
    head, data = (re.search(script.format(name), text, re.DOTALL)[1] for name in ("head", "data"))
    return json.loads(head), zlib.decompress(base64.b64decode(data))


def numbers(data: bytes, place: dict[str, Any]) -> NDArray[np.float64]:
    """An array as the page reads it, shape [T, M, K]."""
    count = int(np.prod(place["shape"]))
    steps = np.frombuffer(data, f"<{place['type']}", count, place["at"]).reshape(place["shape"])
    shares = np.add.accumulate(steps, axis=0, dtype=steps.dtype)
    return np.asarray(np.array(place["low"])[:, None] + np.array(place["step"])[:, None] * shares)


def with_pressure(flow: Trajectory) -> Trajectory:
    """A flow with a pressure that grows along x."""
    return dataclasses.replace(flow, pressure=1.0e3 * flow.positions[:, :, 0])


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_page_has_the_flow(tmp_path: Path, dimension: int) -> None:
    flow, page = with_pressure(toy(dimension)), tmp_path / "flow.html"
    assert flow.view(page) == page
    head, data = parts(page)
    (run,) = head["runs"]
    assert head["times"] == flow.time.tolist()
    extent = np.ptp(flow.positions, axis=(0, 1)).max()
    np.testing.assert_allclose(numbers(data, run["positions"]).swapaxes(1, 2), flow.positions, atol=extent / 65535)
    shown = numbers(data, run["fields"]["pressure"])[:, 0]
    bar = head["fields"]["pressure"]["high"]
    np.testing.assert_allclose(shown, np.minimum(flow.positions[:, :, 0], bar), atol=bar / 255)
    assert set(head["fields"]) == {"velocity", "displacement", "pressure"}
    assert [solid["kind"] for solid in head["solids"]] == ["baffle", "baffle"]
    heights = numbers(data, run["heights"])[:, 0]
    assert heights.max() == pytest.approx(0.08, rel=0.1)
    # The block, in 3D across the box, and of a column at either end a part.
    assert 0.1 <= heights[0].sum() * (head["stations"][1] - head["stations"][0]) / 0.08 <= 0.15


def test_it_is_the_same_file_again_and_fetches_nothing(tmp_path: Path) -> None:
    for name in ("one", "other"):
        write_view(tmp_path / name, toy(2))
    text = (tmp_path / "one").read_text()
    assert text == (tmp_path / "other").read_text()
    assert len(text) < 4e6
    markup = re.sub(r'<script id="(data|plotly)".*?</script>', "", text, flags=re.DOTALL)
    assert not re.search(r"https?:|src=|<link|@import", markup)


def test_many_particles_and_frames_are_thinned_and_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view, "PARTICLES", 50)
    monkeypatch.setattr(view, "FRAMES", 3)
    flow = toy(2)
    write_view(tmp_path / "page.html", flow)
    head, _ = parts(tmp_path / "page.html")
    assert head["runs"][0]["positions"]["shape"] == [3, 2, 50]
    assert f"50 of {flow.positions.shape[1]} particles" in head["about"]
    assert "3 of 6 frames" in head["about"]
    # What is drawn fills as much room.
    assert head["runs"][0]["spacing"] == pytest.approx(np.sqrt(flow.volumes.sum() / 50))


def test_two_flows_have_a_distance_and_one_set_of_materials(tmp_path: Path) -> None:
    flow = toy(2)
    moved = flow.positions.copy()
    moved[-1, :, 1] += np.float32(0.02)
    scene = dataclasses.replace(flow.scene, material=Material(friction_deg=40.0))
    other = dataclasses.replace(flow, positions=moved, scene=scene)
    page = tmp_path / "page.html"
    write_view(page, flow, other, labels=("a", HOSTILE), title=HOSTILE, observed=Observed(front=0.3))
    head, data = parts(page)
    assert "<img" not in re.sub(r'<script id="(data|plotly)".*?</script>', "", page.read_text(), flags=re.DOTALL)
    assert head["runs"][1]["label"] == html.escape(HOSTILE)
    assert head["observed"]["front"] == 0.3
    apart = numbers(data, head["runs"][0]["fields"]["error"])[:, 0]
    np.testing.assert_allclose(apart[:, 0], [0.0] * 5 + [0.02], atol=2e-4)
    assert head["fields"]["material"]["ticks"]["ticktext"] == ["30°", "40°"]
    assert [numbers(data, run["fields"]["material"]).max() for run in head["runs"]] == [0.0, 1.0]
    refused(write_view, page, flow, toy(3), said="expected a 2D flow")


def test_solids_are_those_of_both_and_the_ground_lies_over_the_box(tmp_path: Path) -> None:
    flow, page = toy(2), tmp_path / "page.html"
    moved = dataclasses.replace(flow.scene.baffles[0], lower=(0.25, 0.0))
    ground = Solid(kind="terrain", points=((0.0, 0.0), (0.2, 0.0), (0.5, 0.03)))
    other = dataclasses.replace(flow.scene, baffles=(moved, flow.scene.baffles[1]))
    write_view(page, flow, dataclasses.replace(flow, scene=other))
    assert [solid["kind"] for solid in parts(page)[0]["solids"]] == ["baffle", "baffle", "second"]
    write_view(page, dataclasses.replace(flow, scene=dataclasses.replace(flow.scene, baffles=(), solids=(ground,))))
    head, _ = parts(page)
    assert head["solids"] == []
    expected = np.maximum(0.1 * np.array(head["ground"]["x"]) - 0.02, 0.0)
    np.testing.assert_allclose(head["ground"]["y"], expected, atol=1e-6)


@pytest.mark.skipif(BROWSER is None, reason="no Chromium")
@pytest.mark.parametrize("dimension", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_a_browser_opens_it_from_disk_and_its_slider_moves_the_picture(tmp_path: Path, dimension: int) -> None:
    page = tmp_path / "page.html"
    with_pressure(toy(dimension)).view(page)
    moved = """<script>addEventListener("load", () => { const wait = setInterval(() => {
        if (!document.body.dataset.ready) return;
        clearInterval(wait);
        slider.value = 2;
        slider.dispatchEvent(new Event("input"));
    }, 50); });</script>"""
    (tmp_path / "moved.html").write_text(page.read_text() + moved)
    pictures = []
    for name in ("page.html#frame=5&colour=pressure", "moved.html#frame=5&colour=pressure"):
        shot = tmp_path / "shot.png"
        _, log = browse(f"file://{tmp_path / name}", f"--screenshot={shot}")
        assert not re.search(r"Uncaught|TypeError|net::ERR", log)
        pictures.append(imread(shot)[90:500])
    dom, _ = browse(f"file://{tmp_path / name}", "--dump-dom")
    assert re.search('<body[^>]* data-frame="2" data-colour="pressure" data-ready="yes">', dom)
    assert np.ptp(pictures[0], axis=2).max() > 0.3, "the flow is drawn in colours"
    assert np.abs(pictures[0] - pictures[1]).max() > 0.3


def browse(address: str, *flags: str) -> tuple[str, str]:
    """The page's elements, once it has drawn, and what it wrote to the console."""
    command = [str(BROWSER), "--headless", "--no-sandbox", "--enable-unsafe-swiftshader", "--window-size=900,700"]
    command += ["--virtual-time-budget=20000", "--enable-logging=stderr", *flags, address]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    return done.stdout, done.stderr
