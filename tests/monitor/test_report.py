# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A report says what the flights say, in one file that needs nothing else."""

import itertools
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.pages import needs_chromium, opened, require_for_everybody, wait_until_drawn
from support.written_bags import SAMPLE

from gtmr_model import Helix, Tower, Vehicle
from gtmr_monitor.bag.flight import read_flight
from gtmr_monitor.bag.format import BagError
from gtmr_monitor.coverage import Coverage
from gtmr_monitor.flight import Flight, MarginHistory
from gtmr_monitor.report import look
from gtmr_monitor.report.curves import SECTIONS
from gtmr_monitor.report.page import CAPTIONS, write_report
from gtmr_monitor.report.paper import FIGURES

pytestmark = pytest.mark.slow

T = 0.025 * np.arange(400)
STAGES = 21
MARGIN_M = 0.002


def flight(mode, clearance_m, **changes):
    """A flight at a clearance that swings by 5 cm."""
    radius = 1.0 + clearance_m + 0.05 * np.cos(T)
    angle = 0.4 * T
    p = np.stack([radius * np.cos(angle), radius * np.sin(angle), 2.0 + 0.05 * T], axis=1)
    eta = np.stack([0.01 * np.sin(T), 0.01 * np.cos(T), angle + np.pi], axis=1)
    tightening = MARGIN_M if mode == "robust" else 0.0
    stages = np.full((T.size, STAGES), tightening)
    fields = {
        "name": f"bag-{mode}",
        "source": Path(f"bag-{mode}"),
        "t": T,
        "p": p,
        "eta": eta,
        "recorded_residual": 1.2 - radius,
        "t_rotors": T,
        "rotor_speed_hz": 60.0 + np.outer(np.sin(T), np.arange(6)),
        "margins": MarginHistory(
            T, np.full((T.size, STAGES, 9), tightening), stages, stages, 0.0 * stages
        ),
        "t_solve": T,
        "solve_ms": 5.0 + 25.0 * (np.arange(T.size) % 100 == 0),
        "modes": ((0.0, mode),),
        "deadline_ms": 25.0,
        "tower": Tower(),
        "helix": Helix(),
        "coverage": Coverage(covered_s=10.0, expected_s=10.0),
        "zeta": (0.1, 0.0, 0.0, 0.0, -0.05, 0.0, 0.6, 0.4, 0.0),
        "gust": "ou",
        "seed": 42,
    }
    return Flight(**fields | changes)


NOMINAL = flight("nominal", clearance_m=0.24)
ROBUST = flight("robust", clearance_m=0.30)


class Page(HTMLParser):
    """What a browser would do with the page."""

    def __init__(self, text):
        super().__init__()
        self.loaded, self.ids, self.cells, self.scripts = [], set(), [], 0
        self._in_cell = self._in_style = False
        self.style = ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.ids.add(attributes.get("id"))
        self.scripts += tag == "script"
        self._in_style = tag == "style"
        self.loaded += [v for k, v in attributes.items() if k in ("src", "srcset", "href", "data")]
        if tag in ("td", "th"):
            self._in_cell = True
            self.cells.append("")

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self._in_cell = False

    def handle_data(self, data):
        if self._in_cell:
            self.cells[-1] += data
        if self._in_style:
            self.style += data

    def row(self, title):
        start = self.cells.index(title)
        return self.cells[start + 1 : start + 3]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_report([NOMINAL, ROBUST], tmp_path_factory.mktemp("out") / "new" / "report.html")


@pytest.fixture(scope="module")
def text(written):
    return written[0].read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


def test_asks_the_network_for_nothing(text, page):
    assert page.loaded == ["data:,"]
    assert "url(" not in page.style
    assert "@import" not in page.style


def test_offers_no_upload_of_a_chart(text):
    assert "showSendToCloud: false" in text


def test_holds_plotly_once_and_every_section_that_has_something_to_show(text, page):
    assert text.count('id="plotly"') == 1
    assert set(SECTIONS) == set(CAPTIONS)
    assert set(FIGURES) < set(SECTIONS)
    assert set(SECTIONS) - page.ids == {"wind", "commands"}, "neither was recorded"


def test_wind_slack_commands_and_tracking_error_are_drawn_where_they_are_known(tmp_path):
    x = np.hstack([ROBUST.p, ROBUST.eta, np.zeros((400, 6)), np.full((400, 6), 60.0)])
    rows = {
        "t": T, "x": x,
        "u": np.zeros((400, 6)), "wind_n": np.full((400, 3), 0.5), "w_g": np.zeros((400, 3)),
        "alpha_p": np.full((400, 21), 0.05), "alpha_g": np.zeros((400, 21)),
        "slack": np.full((400, 21), 0.003),
    }  # fmt: skip
    flown = Flight.from_rows(
        rows, name="x", mode="robust", tower=Tower(), helix=Helix(), vehicle=Vehicle.paper()
    )

    html, *_ = write_report([flown], tmp_path / "report.html")

    page = Page(html.read_text(encoding="utf-8"))
    assert set(SECTIONS) - page.ids == {"solve_times"}
    assert page.row("largest slack [mm]")[0] == "3.00"
    error_m = np.linalg.norm(ROBUST.p - Helix().at(T, Tower()).position, axis=1).max()
    assert page.row("maximum [m]")[0] == f"{error_m:.3f}"


def test_figures_are_images_large_enough_to_print(written):
    assert [p.suffix for p in written] == [".html"] + [".png"] * len(FIGURES)
    for path in written[1:]:
        with Image.open(path) as image:
            assert image.width >= 1200
            assert len(image.convert("RGB").getcolors(10**6)) > 20


def test_summary_puts_the_modes_side_by_side(page):
    assert page.row("minimum clearance [m]") == ["0.190", "0.250"]
    assert page.row("clearance violated")[0].startswith("✗ yes")
    assert page.row("clearance violated")[1] == "no"
    assert page.row("deadline misses") == ["4 of 400", "4 of 400"]
    assert page.row("solve time, median [ms]") == ["5.00", "5.00"]


def test_flight_conditions_name_the_truth_and_the_seed(page):
    assert page.row("true mismatch, mass") == ["10.0 %", "10.0 %"]
    assert page.row("true mismatch, thrust") == ["−5.0 %", "−5.0 %"]
    assert page.row("true wind bias, x, east") == ["0.60 N", "0.60 N"]
    assert page.row("seed") == ["42", "42"]
    assert page.row("gusts") == ["ou", "ou"]


def test_parts_of_the_margins_add_up_to_the_total():
    parts = look.margin_parts(ROBUST.margins)

    assert sum(parts.values()) == pytest.approx(ROBUST.margins.total)
    assert ROBUST.margins.total == pytest.approx(np.full((T.size, STAGES), 11 * MARGIN_M))
    # Noise and estimate are drawn where they are not zero, which in the paper they are.
    assert list(parts) == list(look.MARGIN_COLOURS)[:11]
    assert list(look.MARGIN_COLOURS) == list(look.MARGIN_LABELS)


def test_of_margins_known_as_a_whole_the_parts_add_up_too():
    none = np.zeros((T.size, STAGES))
    margins = MarginHistory(
        T, np.zeros((T.size, STAGES, 0)), none, none + 0.01, none, parametric=none + 0.05
    )

    assert margins.alpha_p == pytest.approx(none + 0.05)
    assert sum(look.margin_parts(margins).values()) == pytest.approx(margins.total)
    assert margins.total == pytest.approx(none + 0.06)


def test_a_mode_looks_the_same_in_every_report():
    both, alone = look.lines([NOMINAL, ROBUST]), look.lines([ROBUST])

    assert both[1] == alone[0]
    assert both[0].colour != both[1].colour


def test_flights_of_one_mode_are_told_apart():
    first, second = look.lines([ROBUST, replace(ROBUST, name="again")])

    assert first.dash != second.dash
    assert (first.label, second.label) == ("robust (bag-robust)", "robust (again)")


def test_a_bag_with_odometry_only_makes_a_report_too(tmp_path):
    none = np.zeros((0, 0))
    nothing = MarginHistory(np.zeros(0), np.zeros((0, 0, 9)), none, none, none)
    bare = replace(
        NOMINAL, margins=nothing, t_solve=np.zeros(0), solve_ms=np.zeros(0), modes=(),
        t_rotors=np.zeros(0), rotor_speed_hz=none, deadline_ms=float("nan"), zeta=None,
        gust=None, seed=None, truncated=True,
    )  # fmt: skip

    html, *figures = write_report([bare], tmp_path / "report.html")

    text = html.read_text(encoding="utf-8")
    assert Page(text).row("deadline misses")[0] == "not recorded"
    assert Page(text).row("minimum clearance of the airframe [m]")[0] == "not recorded"
    assert "the bag has no end" in text
    assert all(p.is_file() for p in figures)


def test_a_switch_of_the_mode_is_shown_and_names_are_written_as_text(tmp_path):
    switched = replace(ROBUST, modes=((0.0, "nominal"), (5.0, "robust")))
    odd = replace(ROBUST, name="<script>x</script>", modes=())

    html, *_ = write_report([switched, odd], tmp_path / "report.html")

    text = html.read_text(encoding="utf-8")
    assert "nominal → robust" in text
    assert "&lt;script&gt;x" in text
    assert "<script>x" not in text.replace(r"\u003cscript", "")


def test_the_guard_is_shown_and_told_in_words(tmp_path):
    guarded = replace(ROBUST, guarded=((2.0, 2.5), (4.0, 4.25)))

    html, *_ = write_report([NOMINAL, guarded], tmp_path / "report.html")

    text = html.read_text(encoding="utf-8")
    assert (
        "robust: the guard was in charge, not the controller, for 0.75 s: 2.00 to 2.50 s, 4.00 "
        "to 4.25 s."
    ) in text
    assert Page(text).row("guard in charge [s]") == ["not recorded", "0.75"]
    assert text.count('"fillcolor":"var(--guard)"') == 2


def test_the_thinner_of_two_lines_that_coincide_lies_on_top():
    flown = list(zip([ROBUST, NOMINAL], look.lines([ROBUST, NOMINAL]), strict=True))

    assert [line.label for _, line in look.stacked(flown)] == ["nominal", "robust"]
    assert flown[0][1].width_px < 0.6 * flown[1][1].width_px


@pytest.mark.parametrize("seconds", [5.0, 25.0])
def test_the_camera_stands_before_what_is_to_be_seen(seconds):
    shown = slice(0, int(seconds / 0.025))
    angle = 0.4 * 0.025 * np.arange(int(seconds / 0.025))
    clearance = 0.3 - 0.1 * (np.abs(np.angle(np.exp(1j * (angle - 2.5)))) < 0.05)
    p = np.column_stack([(1.0 + clearance) * np.cos(angle), (1.0 + clearance) * np.sin(angle),
                         2.0 + 0.0 * angle])[shown]  # fmt: skip
    flown = [(replace(ROBUST, t=0.025 * np.arange(len(p)), p=p), look.lines([ROBUST])[0])]

    # Of a short flight its middle, of one all around the tower the place of the least clearance.
    expected = 1.0 if seconds == 5.0 else 2.5
    assert look.viewpoint(flown) == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("theme", [0, 1])
def test_every_colour_of_a_line_stands_out_from_the_page(theme):
    def luminance(colour):
        parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
        linear = np.where(parts <= 0.03928, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return linear @ (0.2126, 0.7152, 0.0722)

    page = luminance(look.PALETTE["page"][theme])
    for name in (*look.MODES, "limit", "quiet", "axis-x", "axis-y", "axis-z"):
        light, dark = sorted((luminance(look.PALETTE[name][theme]), page), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 3.0, name


def test_without_flights_or_place_it_says_so(tmp_path):
    with pytest.raises(ValueError, match="at least one flight"):
        write_report([], tmp_path / "report.html")
    (tmp_path / "file").touch()
    with pytest.raises(BagError, match="cannot write"):
        write_report([ROBUST], tmp_path / "file" / "report.html")


WITHOUT_ROS = """
import sys
for package in ("rclpy", "std_msgs", "nav_msgs", "rcl_interfaces", "builtin_interfaces"):
    sys.modules[package] = None
import gtmr_monitor.report.page
from gtmr_monitor import BagWriter, read_flight, read_messages
with BagWriter(sys.argv[1]) as bag:
    bag.add_topic("/odom", "nav_msgs/msg/Odometry")
assert list(read_messages(sys.argv[1])) == []
assert read_flight(sys.argv[2]).vehicle is not None
"""


def test_bags_and_reports_need_no_ros(tmp_path):
    subprocess.run(
        [sys.executable, "-c", WITHOUT_ROS, tmp_path / "bag", SAMPLE], check=True, timeout=60
    )


@needs_chromium
def test_everybody_can_read_the_report_on_every_screen_in_both_themes(written, axe):
    with opened(written[0]) as browser:
        wait_until_drawn(browser)
        charts = browser.evaluate("document.querySelectorAll('.chart .main-svg').length")
        assert charts >= browser.evaluate("document.querySelectorAll('.chart').length")
        require_for_everybody(browser, axe)
        # Charts have the colours of the theme, also where it changes while they are there.
        ink = "getComputedStyle(document.querySelector('#residual-0 .xtitle')).fill"
        browser.prefer("light")
        browser.wait_until(lambda: browser.evaluate(ink) == "rgb(26, 26, 26)")


@needs_chromium
def test_zooming_into_one_curve_zooms_all_over_time(written):
    with opened(written[0]) as browser:
        wait_until_drawn(browser)
        browser.evaluate("Plotly.relayout('residual-0', {'xaxis.range': [2, 4]}); 0")
        for other in ("clearance-0", "rotors-1", "attitude-2"):
            shown = f"document.getElementById('{other}').layout.xaxis.range.join()"
            browser.wait_until(lambda shown=shown: browser.evaluate(shown) == "2,4")


@needs_chromium
def test_an_hour_of_flight_keeps_its_least_clearance_and_stays_small(tmp_path):
    t = 0.025 * np.arange(144_000)
    angle, radius = 0.4 * t, 1.3 + 0.05 * np.cos(t)
    radius[77_777] = 1.1234
    p = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 2.0 + 0.05 * t])
    stages = np.full((t.size, 21), 0.001)
    hour = replace(
        ROBUST, t=t, p=p, eta=np.zeros_like(p), t_rotors=t, t_solve=t,
        rotor_speed_hz=60.0 + np.random.default_rng(0).normal(size=(t.size, 6)),
        solve_ms=np.random.default_rng(1).uniform(1.0, 9.0, t.size),
        margins=MarginHistory(t, np.full((t.size, 21, 9), 0.002), stages, stages, 0.0 * stages),
    )  # fmt: skip

    html, *_ = write_report([hour], tmp_path / "report.html")

    assert html.stat().st_size < 6e6
    with opened(html) as browser:
        wait_until_drawn(browser)
        least = "Math.min(...document.getElementById('clearance-0')._fullData[0].y)"
        assert browser.evaluate(least) == pytest.approx(0.1234, abs=1e-6)
        assert browser.evaluate("+document.documentElement.dataset.drawnMs") < 40_000.0
        assert browser.complaints == []


def test_a_path_has_the_colours_of_the_modes_that_flew_it():
    flight = read_flight(SAMPLE)
    (line,) = look.lines([flight])

    pieces = look.by_mode([(flight, line)])

    assert [own.label for _, own in pieces] == ["nominal", "robust", "offset_free"]
    assert len({own.colour for _, own in pieces}) == 3
    assert [piece.t[0] for piece, _ in pieces[1:]] == pytest.approx([7.0, 14.0], abs=0.05)
    # Nothing is left out between them, and the whole is there.
    for (before, _), (after, _) in itertools.pairwise(pieces):
        assert before.t[-1] >= after.t[0]
    assert (pieces[0][0].t[0], pieces[-1][0].t[-1]) == (flight.t[0], flight.t[-1])
    # A flight in one mode stays as it is.
    assert look.by_mode([pieces[0]]) == [pieces[0]]
