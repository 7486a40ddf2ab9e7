# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The live view of the demo: a page on loopback that draws what the nodes publish."""

import io
import socket
import sys
from urllib.parse import urlsplit

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from matplotlib import image
from rosgraph_msgs.msg import Clock
from support.loop_messages import odometry_message, rotor_states_message
from support.ros_graph import RosGraph

from gtmr_model import Tower, Vehicle
from gtmr_msgs_py import contract, topics
from gtmr_msgs_py.messages import clearance, markers, path, tightening
from gtmr_msgs_py.wire import stamps
from gtmr_study.cli import demo
from gtmr_study.result_files import InputError

viser = pytest.importorskip("viser", reason="viser is not installed: pip install viser")

from support import chromium  # noqa: E402 -- its WebSocket client comes with viser

from gtmr_study.ros import live  # noqa: E402
from gtmr_study.ros.live_page import LivePage  # noqa: E402
from gtmr_study.ros.live_record import FlightRecord, Moment  # noqa: E402
from gtmr_study.ros.live_status import Standing, status  # noqa: E402

DURATION_S = 10.0
STATE = np.r_[1.32, 0.0, 2.5, 0.0, 0.0, 0.0, np.zeros(6), np.full(6, 61.5)]
AT_REST = np.r_[np.zeros(12), STATE[12:]]
MARGINS = np.linspace(0.0, 0.09, 21)
PLAN = np.stack(
    [np.full(21, 1.32), np.linspace(0.0, 0.25, 21), np.linspace(2.5, 2.53, 21)], axis=1
)


@pytest.fixture
def page():
    page = LivePage(DURATION_S, ("nominal", "robust"), 0.2)
    yield page
    page.stop()


def test_nobody_but_this_machine_can_open_the_page(page):
    port = urlsplit(page.url).port
    with socket.create_connection(("127.0.0.1", port), timeout=5.0):
        pass
    # Served at all addresses, it would answer at this one too.
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.2", port), timeout=5.0)


def test_two_demos_have_two_pages(page):
    other = LivePage(DURATION_S, ("nominal",), 0.2)
    assert other.url != page.url
    other.stop()


@pytest.mark.skipif(chromium.find() is None, reason="there is no Chromium on this machine")
def test_a_browser_draws_the_page_and_asks_nobody_else_for_anything(page):
    tower = Tower()
    page.draw(markers.tower(tower))
    page.add_joints(tower)
    page.draw(markers.vehicle(Vehicle.paper(), AT_REST), contract.BASE_LINK)
    page.draw(markers.tightened_shells(tower, MARGINS, PLAN[:, 2], "robust"))
    page.draw(markers.plan(PLAN, "robust"))
    page.move(odometry_message(0, STATE).pose.pose)
    for time_s in np.arange(0.0, 6.0, 0.025):
        page.add_residual("nominal", time_s, 0.01)
        page.add_residual("robust", time_s, -0.12)
    page.show("robust", 0.09)

    def pixels(window):
        shot = image.imread(io.BytesIO(window.screenshot()))
        return np.round(255.0 * shot[..., :3]).astype(int)

    with chromium.Page(page.url, 800, 600) as window:
        window.wait_until(lambda: "0.320 m" in (window.evaluate("document.body.innerText") or ""))
        # The scene fades in, then holds many shades; an empty one holds white alone.
        scene_width = int(window.evaluate("document.querySelectorAll('canvas')[1].clientWidth"))
        window.wait_until(
            lambda: len(np.unique(pixels(window)[:, :scene_width].reshape(-1, 3), axis=0)) > 500
        )
        text = window.evaluate("document.body.innerText")
        requests, complaints = window.requests, window.complaints

    assert "robust controller" in text
    assert "0.190 m" in text  # the least clearance of the nominal flight
    assert requests
    own = urlsplit(page.url).netloc
    for request in map(urlsplit, requests):
        assert request.scheme in ("data", "blob") or request.netloc == own, request.geturl()
    assert not complaints


class Recorder:
    """Stands in for the page, and its panel."""

    following = True

    def __init__(self, duration_s, modes, min_clearance_m):
        self.drawn, self.residuals, self.shown, self.times = {}, [], [], []
        self.values, self.told = {}, []
        self.panel, self.flying_mode = self, modes[0]

    def draw(self, drawn, frame="map"):
        self.drawn |= {(marker.ns, marker.id): marker for marker in drawn}

    def add_joints(self, tower):
        pass

    def add_residual(self, *sample):
        self.residuals.append(sample)

    def move(self, pose):
        self.pose = pose

    def blow(self, force_n):
        self.wind_n = force_n

    def show(self, *now):
        self.shown.append(now)

    def follow(self, mode):
        self.flying_mode = mode

    def at(self, time_s):
        self.times.append(time_s)

    def set(self, name, value):
        self.values[name] = value

    def tell(self, answer):
        self.told.append(answer)

    def flown(self):
        self.over = True

    def stop(self):
        self.stopped = True


def test_the_view_draws_what_it_hears(monkeypatch):
    monkeypatch.setattr(live, "LivePage", Recorder)
    view = live.LiveView(DURATION_S, ["robust"])
    level, stamp_ns, step_ns = np.zeros((21, 3)), stamps.nanoseconds(1.5), 25_000_000
    margins = tightening.pack(np.zeros((21, 9)), 0.001, MARGINS, np.zeros(21))
    said = (
        (topics.CLOCK, Clock(clock=stamps.encode(stamp_ns))),
        (topics.ODOM, odometry_message(stamp_ns, STATE)),
        (topics.ROTOR_STATES, rotor_states_message(stamp_ns, STATE[12:])),
        (topics.PREDICTED_PATH, path.pack(stamp_ns, step_ns, PLAN, level)),
        (topics.REFERENCE, path.pack(stamp_ns, step_ns, PLAN, level)),
        (topics.TIGHTENING, margins),
        (topics.CLEARANCE_RESIDUAL, clearance.encode_residual(-0.12)),
    )
    page = view.page
    # Who is in charge is for the simulator to say, and not for a view of the plan.
    wanted = {*markers.NAMESPACES, "reference"} - {"guard"}
    with RosGraph() as graph:
        refresh = view.watch(graph.node, "robust")
        publishers = [(topic.publisher(graph.node), message) for topic, message in said]

        def complete():
            for publisher, message in publishers:
                publisher.publish(message)
            assert not refresh()
            drawn = {namespace for namespace, _ in page.drawn}
            heard = ("robust", 1.5, -0.12) in page.residuals
            return drawn >= wanted and heard and page.shown[-1][1] > 0.0

        graph.wait_until(complete)
    at = odometry_message(0, STATE).pose.pose.position
    assert page.pose.position == at
    assert page.shown[-1] == ("robust", pytest.approx(0.091))
    shell = page.drawn["tightened", 0]
    assert 0.5 * shell.scale.x == pytest.approx(1.0 + 0.2 + 0.091)
    assert ("thrust", 5) in page.drawn
    # Smooth, also where the points that were published are far apart.
    assert len(page.drawn["reference", 0].points) == 161


def moment(time_s, x, mode="robust"):
    body = np.r_[x, STATE[1:12]]
    return Moment(time_s, mode, body, STATE[12:], PLAN, MARGINS)


def test_every_moment_of_every_flight_can_be_looked_at(monkeypatch):
    monkeypatch.setattr(live, "LivePage", Recorder)
    view = live.LiveView(DURATION_S, ["nominal", "robust"])
    for k in range(100):
        view.records["nominal"].add(moment(0.1 * k, 1.3 + 0.001 * k, "nominal"))
    view.records["robust"].add(moment(0.0, 2.0))
    for flight, time_s, x in (("nominal", 5.04, 1.35), ("nominal", 99.0, 1.399), ("robust", 5, 2)):
        view.scrub(flight, time_s)
        assert view.page.pose.position.x == pytest.approx(x)
        color = view.page.drawn["plan", 0].color
        assert color.r == pytest.approx(markers.MODE_COLORS[flight].r)


def test_a_long_flight_is_kept_at_fewer_moments_a_second():
    record = FlightRecord(duration_s=36_000.0)
    for k in range(20_000):
        record.add(moment(1.8 * k, 1.3))
    assert 3000 <= len(record.moments) <= 4001
    assert FlightRecord(1.0).at(0.5) is None


def test_it_stays_until_ctrl_c_and_then_serves_nobody(monkeypatch):
    monkeypatch.setattr(live, "LivePage", Recorder)
    view = live.LiveView(DURATION_S, ["robust"])

    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(live.time, "sleep", interrupt)
    view.stay()
    assert view.page.over
    assert view.page.stopped
    view.change("mode", "nominal")
    assert view.page.told == ["no flight to change"]


def test_what_is_chosen_on_the_page_the_nodes_take_or_refuse(monkeypatch):
    monkeypatch.setattr(live, "LivePage", Recorder)
    view = live.LiveView(DURATION_S, ["nominal"])
    page = view.page
    with RosGraph() as graph:
        graph.start("gtmr_nmpc.node", mode="nominal")
        graph.start("gtmr_sim.node", zeta=f"[{', '.join(['0.0'] * 6)}, 0.6, 0.4, 0.0]")
        refresh = view.watch(graph.node, "nominal")

        def until(condition):
            graph.wait_until(lambda: (refresh(), condition())[1])

        until(lambda: page.values.get("zeta") and page.values.get("mode") == "nominal")
        assert list(page.wind_n) == [0.6, 0.4, 0.0]
        view.change("mode", "robust")
        view.change("wind", (0.1, -0.2, 0.3))
        view.change("real_time_factor", 0.5)
        until(lambda: page.values["mode"] == "robust" and page.values["real_time_factor"] == 0.5)
        until(lambda: list(page.wind_n) == [0.1, -0.2, 0.3])
        assert graph.get_parameter("nmpc", "mode") == "robust"
        assert list(graph.get_parameter("sim", "zeta"))[6:] == [0.1, -0.2, 0.3]
        assert not any(page.told)

        page.values.clear()
        view.change("gust.std_n", -1.0)
        until(lambda: any(page.told) and "gust.std_n" in page.values)
        assert page.told[-1].startswith("sim refused gust.std_n: ")
        assert page.values["gust.std_n"] == graph.get_parameter("sim", "gust.std_n") >= 0.0

        view.change("pause", True)
        assert refresh()  # so that nobody takes the flight for stuck
        status = graph.node.create_subscription(
            DiagnosticArray, "/diagnostics", graph.received["status"].append, 10
        )
        until(lambda: any(
            each.message == "paused" for m in graph.received["status"] for each in m.status
        ))  # fmt: skip
        graph.node.destroy_subscription(status)


WIDTHS = (1400, 420)


@pytest.mark.skipif(chromium.find() is None, reason="there is no Chromium on this machine")
@pytest.mark.parametrize("width", WIDTHS)
def test_a_click_on_the_page_is_told(page, width):
    chosen, scrubbed = [], []
    page.panel.on_change = lambda *choice: chosen.append(choice)
    page.panel.on_scrub = lambda *choice: scrubbed.append(choice)
    with chromium.Page(page.url, width, 800) as window:
        window.resize(width, 800)
        window.wait_until(lambda: "Change in flight" in text_of(window))
        for label in ("Look back", "Flight", "Time [s]", "Mode", "Pause", "Pace", "Gust [N]"):
            assert label in text_of(window)
        click(window, control("Mode"))
        option = (
            "[...document.querySelectorAll('[role=option]')].find("
            "(o) => o.innerText == 'robust' && o.offsetParent)"
        )
        window.wait_until(lambda: window.evaluate(f"Boolean({option})"))
        click(window, option)
        window.wait_until(lambda: ("mode", "robust") in chosen)
        click(window, control("Pause"))
        window.wait_until(lambda: ("pause", True) in chosen)
        # In the middle of the slider is the middle of the flight.
        click(window, control("Time [s]"))
        window.wait_until(lambda: bool(scrubbed))
        assert scrubbed[-1][1] == pytest.approx(0.5 * DURATION_S, abs=0.1 * DURATION_S)
        assert scrubbed[-1][0] == "nominal"
        assert not page.panel.following
        assert window.overflow_px() <= 0
        assert not window.complaints


def text_of(window):
    return window.evaluate("document.body.innerText") or ""


def control(label):
    """What a label belongs to, in JavaScript: so a user finds it, and a screen reader."""
    labels = "[...document.querySelectorAll('label')]"
    return f"document.getElementById({labels}.find((l) => l.innerText == '{label}').htmlFor)"


def click(window, element):
    """Click in the middle of an element, given in JavaScript, as a user does."""
    x, y = window.evaluate(
        f"(() => {{const e = {element}; e.scrollIntoView({{block: 'center'}});"
        "const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]})()"
    )
    for kind in ("mousePressed", "mouseReleased"):
        window.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


def test_the_status_says_who_came_too_close():
    close, clear = Standing(), Standing()
    for residual_m in (-0.1, 0.02, -0.05):
        close.add(1.0, residual_m)
    clear.add(1.0, -0.1)
    text = status({"nominal": close, "robust": clear}, "robust", 0.09, 0.2, 10.0)
    assert "0.180 m" in text
    assert text.count(">yes<") == 1
    assert "0.30 m" in text


def test_without_viser_the_demo_says_what_to_install(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("gtmr_study.ros.live")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match="--live needs viser: pip install"):
        demo._live_view(DURATION_S, ["robust"])
