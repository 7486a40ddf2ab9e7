# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Everything that defines the controller's problem, with the defaults' sources."""

from typing import Annotated, Literal

from pydantic import Field, SerializeAsAny, model_validator
from typing_extensions import Self

from gtmr_model import (
    Helix,
    NamedVehicle,
    ReferencePath,
    Tower,
    UncertaintySet,
    Vehicle,
    YamlModel,
)
from gtmr_model.airframe import ClearanceConstraint, ClearanceOf, constraint_on
from gtmr_nmpc.margins import ClosedLoopMargin, Margin, PaperMargin, SecondOrderMargin

Mode = Literal["nominal", "robust", "offset_free"]
MODES: tuple[Mode, ...] = ("nominal", "robust", "offset_free")
"""What the mode can be: the clearance constraint as in eq. (5), tightened as in eq. (15), or
tightened by the margins of a closed loop that estimates its disturbances."""
PAPER_MODES: tuple[Mode, ...] = ("nominal", "robust")
"""The modes that the paper compares."""
TighteningOrder = Literal["frozen", "gradient"]

Weight = Annotated[float, Field(ge=0.0)]
Weight3 = tuple[Weight, Weight, Weight]


class Weights(YamlModel):
    """Diagonals of Q, Q_u and Q_f, eq. (6)."""

    position: Weight3 = (50.0, 50.0, 80.0)
    """Q_p [m^-2] (Table I)."""
    velocity: Weight3 = (5.0, 5.0, 8.0)
    """Q_v [(m/s)^-2] (Table I)."""
    acceleration: Weight3 = (1.0, 1.0, 2.0)
    """Q_a [(m/s^2)^-2] (Table I)."""
    roll_pitch: Weight = 50.0
    """Roll and pitch, held level [rad^-2]; not in the paper."""
    yaw: Weight = 50.0
    """Yaw, facing the tower [rad^-2]; not in the paper."""
    rate: Weight = 5.0
    """Body rates, following the reference's yaw rate [(rad/s)^-2]; not in the paper."""
    rotor_acceleration: Annotated[float, Field(gt=0.0)] = 1e-4
    """Q_u [(Hz/s)^-2]; the paper does not report it."""
    terminal_position: Weight3 = (80.0, 80.0, 120.0)
    """Q_f [m^-2] (Table I)."""


class OdometryNoise(YamlModel):
    """Standard deviations of what is measured; small by default: the paper measures exactly."""

    position_m: float = Field(1e-4, gt=0.0)
    """Of each coordinate of p [m]."""
    velocity_m_s: float = Field(1e-3, gt=0.0)
    """Of each coordinate of v [m/s]."""
    attitude_rad: float = Field(1e-4, gt=0.0)
    """Of roll, pitch and yaw [rad]."""
    rate_rad_s: float = Field(1e-3, gt=0.0)
    """Of each coordinate of omega [rad/s]."""


class DisturbanceModel(YamlModel):
    """How force and torque beyond the nominal model are believed to change."""

    bias_n_per_sqrt_s: float = Field(2.0, gt=0.0)
    """Random walk of the persistent force, per axis [N/sqrt(s)]."""
    gust_n: float = Field(0.3, gt=0.0)
    """Standard deviation of the gust force, per axis [N]."""
    gust_time_s: float = Field(0.5, gt=0.0)
    """tau, correlation time of the gust force [s]."""
    torque_nm_per_sqrt_s: float = Field(0.1, gt=0.0)
    """Random walk of the torque, per axis [N m/sqrt(s)]."""


class OffsetFree(YamlModel):
    """What the mode ``offset_free`` has of its own; not in the paper."""

    weights: Weights = Weights(
        position=(500.0, 500.0, 800.0),
        terminal_position=(800.0, 800.0, 1200.0),
        rotor_acceleration=1e-6,
    )
    """The cost."""
    noise: OdometryNoise = OdometryNoise()
    """Of the odometry, from which the observer's gains follow."""
    disturbance: DisturbanceModel = DisturbanceModel()
    """What the observer looks for."""
    margin: SerializeAsAny[Margin] = ClosedLoopMargin()
    """The margin that tightens the clearance."""


class ControllerConfig(YamlModel):
    """The optimal control problem, eq. (5) and (15), and how it is solved."""

    vehicle: NamedVehicle = Field(default_factory=Vehicle.paper)
    """Nominal parameters of the vehicle."""
    tower: Tower = Tower()
    """What to keep away from."""
    helix: SerializeAsAny[ReferencePath] = Helix()
    """What to follow: a helix, or another path by its kind and numbers."""
    uncertainty: UncertaintySet = UncertaintySet()
    """What the robust mode guards against."""
    weights: Weights = Weights()
    """The cost."""
    horizon: int = Field(20, ge=2, le=100)
    """N, number of stages (Table I)."""
    sampling_time_s: float = Field(0.025, gt=0.0, le=0.5)
    """T_s [s] (Table I)."""
    eps_s_m: float = Field(1e-3, ge=0.0)
    """eps_s, the small slack term in alpha_p, eq. (12) [m]; the paper does not report it."""
    margin: SerializeAsAny[Margin] = PaperMargin()
    """The margin of the robust mode: the paper's, or another by its name and numbers."""
    tightening: TighteningOrder = "frozen"
    """How alpha_p enters the QP: held at the current iterate, or with its gradient (eq. 15)."""
    slack_l1: float = Field(1e4, gt=0.0)
    """Linear penalty on violating the tightened clearance at a stage [1/m]; exact while it
    exceeds the constraint's multiplier."""
    slack_l2: float = Field(1e4, gt=0.0)
    """Quadratic penalty on violating the tightened clearance at a stage [1/m^2]."""
    clearance_of: ClearanceOf = "centre"
    """What the clearance is of: the vehicle's centre, as in the paper, or its airframe, the
    nearest rotor disc. Margins then count how the attitude moves the discs. Within a QP the
    attitude is that of the iterate, so that tilting or turning is no way to keep clear."""
    switch_time_s: float = Field(1.0, ge=0.0, le=10.0)
    """How long margins take to come in, or to go, after the mode was switched in flight [s]; 0 is
    at once, which jerks a vehicle that is inside the tightened shell. Chosen by measurement; the
    paper does not switch."""

    offset_free: OffsetFree = OffsetFree()
    """What the mode ``offset_free`` has of its own."""
    delay_s: float = Field(0.0, ge=0.0, le=0.2)
    """How old a state is when the command made from it acts [s]."""
    motor_lag_s: float = Field(0.0, ge=0.0, le=0.2)
    """Time constant with which rotors follow their speed setpoints [s]; 0 for rotors that take
    accelerations, as in the paper."""

    @model_validator(mode="after")
    def _has_a_gradient(self) -> Self:
        if self.tightening == "gradient" and not isinstance(self.margin, PaperMargin):
            raise ValueError(
                f"tightening = 'gradient': margin = {self.margin.kind!r} has none, allowed is "
                "'frozen'"
            )
        return self

    @model_validator(mode="after")
    def _has_a_margin_of_the_airframe(self) -> Self:
        if self.clearance_of == "airframe" and isinstance(self.margin, SecondOrderMargin):
            raise ValueError(
                f"clearance_of = 'airframe': margin = {self.margin.kind!r} is of the centre alone"
            )
        return self

    @property
    def clearance_constraint(self) -> ClearanceConstraint:
        """The clearance constraint, on what ``clearance_of`` names."""
        return constraint_on(self.clearance_of, self.vehicle)
