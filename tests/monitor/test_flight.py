# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A flight read from a bag is the whole flight, whatever the order in which messages came."""

from dataclasses import replace

import numpy as np
import pytest
from support.written_bags import SAMPLE, cdr, copied, flown, new

from gtmr_model import Helix, Tower, Vehicle
from gtmr_monitor import BagError, BagMessage, Flight, read_flight

CLEAR_M, TOO_CLOSE_M = 0.35, 0.10


def samples(n=100, too_close=(30,)):
    """Stamps 25 ms apart, clear of the tower but for a few instants."""
    return [(0.025 * k, TOO_CLOSE_M if k in too_close else CLEAR_M) for k in range(n)]


def late(samples, k):
    """The same, but message k comes after its follower."""
    return [*samples[:k], samples[k + 1], samples[k], *samples[k + 2 :]]


def early_by_a_nanosecond(samples, k):
    """The same, but message k is stamped a nanosecond before the one that it follows."""
    return [*samples[:k], (samples[k - 1][0] - 1e-9, samples[k][1]), *samples[k + 1 :]]


@pytest.mark.parametrize("disorder", [late, early_by_a_nanosecond])
def test_a_message_out_of_order_hides_no_violation_before_it(tmp_path, disorder):
    flight = read_flight(flown(tmp_path / "bag", ("/odom", disorder(samples(), 60))))

    statistics = flight.residual_statistics
    assert statistics["violated"]
    assert statistics["min_clearance_m"] == pytest.approx(TOO_CLOSE_M)
    assert statistics["samples"] == 100
    assert (np.diff(flight.t) > 0.0).all()
    assert flight.late == {"odom": 1}
    assert any("1 of 100 odom messages came late" in note for note in flight.notes)


def test_a_violation_that_comes_late_is_counted_at_its_own_time(tmp_path):
    flight = read_flight(flown(tmp_path / "bag", ("/odom", late(samples(), 30))))

    assert flight.t[flight.residual > 0.0] == pytest.approx([0.75])


def test_what_came_before_a_reset_is_left_out_but_told(tmp_path):
    flight = read_flight(flown(tmp_path / "bag", ("/odom", samples() + samples(40, ()))))

    assert flight.residual_statistics["samples"] == 40
    assert not flight.residual_statistics["violated"]
    (note,) = flight.notes
    assert "began again" in note
    assert "100 odom" in note
    assert "0.100 m" in note
    assert flight.late == {}


def test_the_sample_bag_has_nothing_to_tell():
    flight = read_flight(SAMPLE)

    assert flight.notes == ()
    assert flight.mode == "nominal → robust → offset_free"


def test_clearance_of_the_airframe_is_that_of_the_recorded_states_and_vehicle(tmp_path):
    flight = read_flight(SAMPLE)
    assert flight.vehicle == Vehicle.paper()
    # Facing the tower, within 0.2 rad and level within 0.1: the front disc is the nearest.
    reach = 0.39 + Vehicle.paper().rotor_radius_m
    below = flight.clearance - flight.airframe_clearance
    np.testing.assert_allclose(below, reach, atol=0.02)
    # A bag of odometry alone does not tell what flew.
    bare = read_flight(flown(tmp_path / "bag", ("/odom", samples())))
    assert bare.vehicle is bare.airframe_clearance is None


@pytest.mark.slow
def test_commands_and_rotor_speeds_out_of_order_keep_their_margins(tmp_path):
    def swap(messages):
        for topic in ("/rotor_command", "/rotor_states"):
            a, b = [k for k, m in enumerate(messages) if m.topic == topic][200:202]
            messages[a], messages[b] = messages[b], messages[a]
        return messages

    whole, mixed = read_flight(SAMPLE), read_flight(copied(SAMPLE, tmp_path / "bag", swap))

    assert mixed.late == {"rotor_command": 1, "rotor_states": 1}
    assert mixed.t_rotors == pytest.approx(whole.t_rotors)
    assert mixed.rotor_speed_hz == pytest.approx(whole.rotor_speed_hz)
    # Margins bear no stamp: they belong to the commands as these were sent.
    assert sorted(mixed.margins.t) == pytest.approx(whole.margins.t)


def without_guard(messages):
    """As from a simulator that tells nothing of its guard."""
    return [m for m in messages if m.topic != "/guard"]


def with_guard(in_charge):
    """The sample bag with a simulator that tells of its guard with every odometry, by its time."""

    def tell(messages):
        begin_ns = min(m.log_time_ns for m in messages if m.topic == "/odom")
        for m in without_guard(messages):
            yield m
            if m.topic == "/odom":
                stamp = m.decode().header.stamp
                now = in_charge(stamp.sec + 1e-9 * stamp.nanosec)
                data = cdr(new("std_msgs/msg/Bool", bool(now)))
                yield BagMessage("/guard", "std_msgs/msg/Bool", m.log_time_ns, begin_ns, data)

    return lambda messages: list(tell(messages))


@pytest.mark.parametrize(
    ("in_charge", "spans"),
    [
        (lambda t: False, ()),
        (lambda t: 2.0 <= t < 2.5 or 4.0 <= t < 4.25, ((2.0, 2.5), (4.0, 4.25))),
        (lambda t: t >= 20.5, ((20.5, 21.0),)),
    ],
)
def test_a_flight_knows_when_the_guard_was_in_charge(tmp_path, in_charge, spans):
    flight = read_flight(copied(SAMPLE, tmp_path / "bag", with_guard(in_charge)))

    assert [t for span in flight.guarded for t in span] == pytest.approx(
        [t for span in spans for t in span], abs=1e-6
    )
    assert flight.guard_time_s == pytest.approx(sum(end - begin for begin, end in spans))


def test_a_flight_without_a_guard_says_that_it_knows_of_none(tmp_path):
    flight = read_flight(copied(SAMPLE, tmp_path / "bag", without_guard))

    assert flight.guard_time_s is None


def test_clearance_is_that_of_the_true_state_where_it_was_recorded(tmp_path):
    def moved(messages):
        """As measured: a decimetre off, and late."""
        for m in messages:
            if m.topic == "/odom":
                odometry = m.decode()
                odometry.pose.pose.position.x += 0.1
                m = replace(m, data=cdr(odometry))
            yield m

    whole = read_flight(SAMPLE)
    measured = read_flight(copied(SAMPLE, tmp_path / "bag", lambda m: list(moved(m))))
    blind = read_flight(
        copied(SAMPLE, tmp_path / "odom", lambda m: [i for i in m if i.topic != "/ground_truth"])
    )

    assert whole.clearance_from == measured.clearance_from == "ground_truth"
    assert blind.clearance_from == "odom"
    assert measured.clearance == pytest.approx(whole.clearance)
    assert blind.clearance == pytest.approx(whole.clearance)


def test_a_bag_of_several_vehicles_asks_which_one(tmp_path):
    bag = flown(tmp_path / "bag", ("/a/odom", samples()), ("/b/odom", samples(50, ())))

    with pytest.raises(BagError, match="several vehicles, name one: /a, /b"):
        read_flight(bag)
    assert read_flight(bag, "/b").t.size == 50


@pytest.mark.slow
def test_a_report_shows_all_vehicles_of_a_bag_or_the_one_named(gtmr, tmp_path):
    bag = flown(tmp_path / "both", ("/a/odom", samples()), ("/b/odom", samples(50, ())))

    all_of_it = gtmr("report", bag, "--out", tmp_path / "all.html")
    one = gtmr("report", bag, "--vehicle", "b", "--out", tmp_path / "one.html")

    assert (all_of_it.returncode, one.returncode) == (0, 0), all_of_it.stderr + one.stderr
    text = (tmp_path / "all.html").read_text(encoding="utf-8")
    assert "unknown (both/a)" in text
    assert "unknown (both/b)" in text
    text = (tmp_path / "one.html").read_text(encoding="utf-8")
    assert "unknown (both/a)" not in text
    assert "unknown (both/b)" in text


def test_a_vehicle_that_is_not_in_the_bag_is_refused_by_name(refused, tmp_path):
    bag = flown(tmp_path / "both", ("/odom", samples()), ("/b/odom", samples()))

    message = refused("report", bag, "--vehicle", "hex9", "--out", tmp_path / "r.html")

    assert "'hex9'" in message
    assert "allowed is /b, /" in message


@pytest.mark.slow
def test_a_report_tells_of_messages_out_of_order(gtmr, tmp_path):
    bag = flown(tmp_path / "bag", ("/odom", late(samples(), 60)))

    run = gtmr("report", bag, "--out", tmp_path / "report.html")

    said = "1 of 100 odom messages came late"
    assert said in run.stderr
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert said in text
    assert "<strong>0.100</strong>" in text


def rows(**changes):
    """Ten rows as those of a flight in process, 0.3 m from the tower."""
    x = np.zeros((10, 18))
    x[:, 0], x[:, 12:] = 1.3, 61.0
    told = {"t": 0.025 * np.arange(10), "x": x, "u": np.full((10, 6), 7.0)}
    stages = dict.fromkeys(("alpha_p", "alpha_g", "slack"), np.full((10, 21), 0.01))
    guard = np.arange(10) % 5 > 2
    return told | stages | {"guard": guard, "zeta": np.arange(9.0)} | changes


MADE = {"name": "x", "mode": "robust", "tower": Tower(), "helix": Helix()}


def test_rows_of_a_flight_in_process_make_a_flight_as_a_bag_does():
    flight = Flight.from_rows(rows(), **MADE, vehicle=Vehicle.paper())

    assert flight.clearance == pytest.approx(np.full(10, 0.3))
    assert flight.rotor_speed_hz.shape == flight.command_hz_s.shape == (10, 6)
    assert flight.margins.total == pytest.approx(np.full((10, 21), 0.02))
    assert np.array(flight.guarded) == pytest.approx(np.array([[0.075, 0.125], [0.2, 0.225]]))
    assert flight.deadline_ms == pytest.approx(25.0)
    assert flight.zeta == tuple(range(9))
    assert flight.airframe_clearance is not None


def test_a_controller_that_tells_no_margins_makes_a_flight_without():
    none = dict.fromkeys(("alpha_p", "alpha_g", "slack"), np.zeros((10, 0)))

    flight = Flight.from_rows(rows(**none), **MADE)

    assert flight.margins.t.size == flight.t_wind.size == 0
    assert flight.solve_statistics is None


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"x": np.zeros((10, 12))}, "expected"), ({"t": np.zeros(9)}, "expected")],
)
def test_rows_that_do_not_fit_together_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        Flight.from_rows(rows(**changes), **MADE)
    with pytest.raises(ValueError, match="a flight has rows u"):
        Flight.from_rows({key: value for key, value in rows().items() if key != "u"}, **MADE)


def test_a_bag_tells_what_was_commanded():
    flight = read_flight(SAMPLE)

    # A stage later the speed has changed by the command, as the plan in the bag goes.
    assert flight.command_hz_s.shape == (len(flight.t_command), 6)
    from_s = flight.t_command[5:50]
    before, after = (
        np.stack([np.interp(t, flight.t_rotors, speed) for speed in flight.rotor_speed_hz.T], 1)
        for t in (from_s, from_s + 0.025)
    )
    assert 0.025 * flight.command_hz_s[5:50] == pytest.approx(after - before, abs=0.05)
