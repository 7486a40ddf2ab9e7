# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parameters come from the configuration models, with unit and range; bad values are refused."""

import pytest
import rclpy
import yaml
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from gtmr_model import ConfigError, Vehicle
from gtmr_msgs_py.node.declarations import declarations
from gtmr_msgs_py.node.parameters import ModelParameters
from gtmr_nmpc.node import NmpcParameters
from gtmr_sim.node import SimNode, SimParameters

PRESETS = SimNode.PRESETS
MODELS = [NmpcParameters, SimParameters]


@pytest.fixture(scope="module")
def context():
    context = Context()
    rclpy.init(context=context, domain_id=101)
    yield context
    rclpy.shutdown(context=context)


@pytest.fixture
def make_node(context):
    nodes = []

    def make(**overrides):
        given = [Parameter(k.replace("__", "."), value=v) for k, v in overrides.items()]
        nodes.append(Node("node", context=context, parameter_overrides=given))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


def nmpc_parameters(node, **options):
    return ModelParameters(node, NmpcParameters, PRESETS, dynamic={"mode"}, **options)


@pytest.mark.parametrize("model", MODELS)
def test_every_parameter_is_described(model):
    for declaration in declarations(model(), PRESETS):
        assert declaration.descriptor.description, declaration.name


@pytest.mark.parametrize("model", MODELS)
def test_every_physical_parameter_names_its_unit(model):
    for declaration in declarations(model(), PRESETS):
        if isinstance(declaration.value, float):
            assert "[" in declaration.descriptor.description, declaration.name


def test_descriptors_carry_the_ranges_of_the_fields():
    described = {d.name: d.descriptor for d in declarations(NmpcParameters(), PRESETS)}
    (horizon,) = described["horizon"].integer_range
    assert (horizon.from_value, horizon.to_value) == (2, 100)
    (period,) = described["sampling_time_s"].floating_point_range
    assert (period.from_value, period.to_value) == (0.0, 0.5)
    assert "greater than 0" in described["sampling_time_s"].additional_constraints
    assert described["mode"].additional_constraints == "one of: nominal, robust, offset_free"
    assert described["weights.position"].additional_constraints == "3 numbers, each at least 0"


def test_only_dynamic_parameters_can_be_written(make_node):
    node = make_node()
    nmpc_parameters(node)
    assert not node.describe_parameter("mode").read_only
    (result,) = node.set_parameters([Parameter("horizon", value=10)])
    assert not result.successful
    assert "read-only" in result.reason


def test_defaults_are_those_of_the_model(make_node):
    assert nmpc_parameters(make_node()).value == NmpcParameters()


def test_values_given_at_start_reach_nested_models(make_node):
    node = make_node(tower__radius_m=1.5, vehicle="octo", weights__velocity=[1.0, 2.0, 3.0])
    config = nmpc_parameters(node).value
    assert config.tower.radius_m == 1.5
    assert config.vehicle.n_rotors == 8
    assert config.weights.velocity == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        ({"mode": "bold"}, "'nominal', 'robust' or 'offset_free'"),
        ({"vehicle": "nope"}, "there is .*paper"),
        ({"horizon": 1}, "horizon out of range"),
        ({"horizon": 20.0}, "horizon .* expected integer"),
        ({"tower__radius_m": 1}, "tower.radius_m .* expected double, as 1.0"),
        ({"sampling_time_s": 0.0}, "greater than 0"),
        ({"weights__position": [1.0, 1.0]}, "weights.position"),
        ({"weights__position": [1.0, 1.0, -1.0]}, r"weights.position.* -1"),
    ],
)
def test_a_bad_value_at_start_is_named_in_one_line(make_node, overrides, reason):
    with pytest.raises(ConfigError, match=reason) as caught:
        nmpc_parameters(make_node(**overrides))
    assert "\n" not in str(caught.value)


def test_a_dynamic_parameter_is_applied_after_it_was_set(make_node):
    node, applied = make_node(), []
    parameters = nmpc_parameters(node, on_change=applied.append)
    (result,) = node.set_parameters([Parameter("mode", value="nominal")])
    assert result.successful
    assert parameters.value.mode == "nominal"
    assert [config.mode for config in applied] == ["nominal"]


def test_a_refused_value_changes_nothing_and_says_why(make_node):
    node, applied = make_node(), []
    parameters = nmpc_parameters(node, on_change=applied.append)
    (result,) = node.set_parameters([Parameter("mode", value="bold")])
    assert not result.successful
    assert "'nominal', 'robust' or 'offset_free'" in result.reason
    assert parameters.value.mode == node.get_parameter("mode").value == "robust"
    assert not applied


def test_a_settled_value_is_shown_and_fixed(make_node):
    node = make_node(sample_zeta=True, seed=5)
    parameters = ModelParameters(node, SimParameters, PRESETS, settle=SimParameters.settled)
    drawn = SimParameters(seed=5).sampled().zeta
    assert parameters.value.zeta == drawn
    assert tuple(node.get_parameter("zeta").value) == drawn
    assert node.describe_parameter("zeta").read_only


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        ({"real_time_factor": 0.0}, "real_time_factor .* needs lockstep"),
        ({"odometry_rate_hz": 100.0}, "sampling_time_s .* whole number .* odometry_rate_hz"),
        ({"sampling_time_s": 0.0255}, "sampling_time_s .* whole number"),
        ({"zeta": [0.5] + [0.0] * 8}, r"zeta\[mass\] = 0.5"),
        ({"zeta": [0.0] * 8}, "zeta"),
    ],
)
def test_a_flight_that_cannot_be_flown_is_refused(make_node, overrides, reason):
    with pytest.raises(ConfigError, match=reason):
        ModelParameters(make_node(**overrides), SimParameters, PRESETS)


def test_a_file_that_a_controllers_file_names_is_beside_it(make_node, tmp_path, monkeypatch):
    paper = Vehicle.paper().model_dump(mode="json")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/mine.yaml").write_text(yaml.safe_dump(paper | {"name": "mine"}))
    (tmp_path / "tuned.yaml").write_text("vehicle: parts/mine.yaml\n")
    monkeypatch.chdir("/")
    node = make_node(controller=str(tmp_path / "tuned.yaml"))
    assert nmpc_parameters(node, base="controller").value.vehicle.name == "mine"
    # As a path that the reader of a bag finds too.
    assert node.get_parameter("vehicle").value == str(tmp_path / "parts/mine.yaml")
