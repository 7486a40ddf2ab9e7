# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The vehicle: rotors of any number, place, tilt and spin on a rigid body (Sec. II-B)."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from typing_extensions import Self

from gtmr_model.yaml_model import YamlModel, named

GRAVITY_M_S2 = 9.81
"""Standard gravity [m/s^2], along -z of the world frame."""

Positive = Annotated[float, Field(gt=0.0)]


class Rotor(YamlModel):
    """One rotor-propeller unit, fixed to the body."""

    position_m: tuple[float, float, float]
    """Rotor centre in the body frame (FLU) [m]."""
    tilt_deg: float = Field(0.0, ge=-90.0, le=90.0)
    """Rotation of the thrust axis about the arm, right-handed about the outward arm [deg]."""
    cant_deg: float = Field(0.0, ge=-90.0, le=90.0)
    """Rotation of the thrust axis about the tangent, after the tilt; positive outward [deg]."""
    spin: Literal["cw", "ccw"]
    """Sense of rotation seen from above; a clockwise rotor pushes the body counter-clockwise."""

    @property
    def axis(self) -> NDArray[np.float64]:
        """Unit thrust axis in the body frame, shape (3,): Rz(azimuth) Rx(tilt) Ry(cant) e3."""
        azimuth = math.atan2(self.position_m[1], self.position_m[0])
        tilt, cant = math.radians(self.tilt_deg), math.radians(self.cant_deg)
        along_arm = math.sin(cant)
        tangential = -math.sin(tilt) * math.cos(cant)
        up = math.cos(tilt) * math.cos(cant)
        c, s = math.cos(azimuth), math.sin(azimuth)
        return np.array([c * along_arm - s * tangential, s * along_arm + c * tangential, up])


class Vehicle(YamlModel):
    """A generically tilted multirotor (GTMR)."""

    name: str
    """What to call it in reports."""
    mass_kg: Positive
    """m0, nominal mass [kg]."""
    inertia_kg_m2: tuple[Positive, Positive, Positive]
    """J0, nominal principal inertia in the body frame [kg m^2]."""
    drag_n_s_per_m: Annotated[float, Field(ge=0.0)]
    """D0, nominal linear drag, isotropic [N s/m]."""
    force_coefficient_n_per_hz2: Positive
    """c_f, thrust per squared rotor speed [N/Hz^2]."""
    torque_coefficient_nm_per_hz2: Annotated[float, Field(ge=0.0)]
    """c_t, drag torque per squared rotor speed [N m/Hz^2]."""
    min_rotor_speed_hz: Annotated[float, Field(ge=0.0)]
    """Lower rotor speed limit [Hz]."""
    max_rotor_speed_hz: Positive
    """Upper rotor speed limit [Hz]."""
    max_rotor_acceleration_hz_s: Positive
    """Limit of |u|, the rotor acceleration [Hz/s]."""
    rotor_radius_m: Annotated[float, Field(ge=0.0)] = 0.0
    """Radius of a rotor disc [m]; 0 where it is not known, and the hubs alone count."""
    rotors: tuple[Rotor, ...] = Field(min_length=1)
    """The rotors, in the order of xi and of every message."""

    @model_validator(mode="after")
    def _flies(self) -> Self:
        if self.min_rotor_speed_hz >= self.max_rotor_speed_hz:
            raise ValueError(
                f"min_rotor_speed_hz {self.min_rotor_speed_hz} must be below "
                f"max_rotor_speed_hz {self.max_rotor_speed_hz}"
            )
        hover = self.hover_rotor_speeds_hz
        outside = (hover < self.min_rotor_speed_hz) | (hover > self.max_rotor_speed_hz)
        if np.isnan(hover).any() or outside.any():
            raise ValueError(
                "no level hover within the rotor speed limits (hover would need "
                f"{np.array2string(hover, precision=1)} Hz): check rotors, spins and mass_kg"
            )
        return self

    @classmethod
    def paper(cls) -> Vehicle:
        """Return the paper's Tilt-Hex (Table I), with the signs of the LAAS Tilt-Hex."""
        return cls.preset("vehicle", "paper")

    @property
    def n_rotors(self) -> int:
        """N_p, the number of rotors."""
        return len(self.rotors)

    @property
    def n_x(self) -> int:
        """Length of the state x = [p, eta, v, omega, xi], 12 + N_p."""
        return 12 + self.n_rotors

    @property
    def allocation(self) -> NDArray[np.float64]:
        """Wrench per squared rotor speed [N/Hz^2; N m/Hz^2], shape (6, N_p), body frame.

        Column i is ``[c_f z_i; p_i x c_f z_i + sigma_i c_t z_i]``; sigma_i is +1 for a clockwise
        rotor, whose reaction torque turns the body counter-clockwise.
        """
        columns = []
        for rotor in self.rotors:
            force = self.force_coefficient_n_per_hz2 * rotor.axis
            sigma = 1.0 if rotor.spin == "cw" else -1.0
            drag_torque = sigma * self.torque_coefficient_nm_per_hz2 * rotor.axis
            columns.append(np.r_[force, np.cross(rotor.position_m, force) + drag_torque])
        return np.array(columns).T

    @property
    def hover_rotor_speeds_hz(self) -> NDArray[np.float64]:
        """Rotor speeds of level hover [Hz], shape (N_p,), least norm of the squared speeds.

        NaN where a squared speed would be negative or the wrench cannot be reached.
        """
        weight = np.array([0.0, 0.0, self.mass_kg * GRAVITY_M_S2, 0.0, 0.0, 0.0])
        squared, *_ = np.linalg.lstsq(self.allocation, weight, rcond=None)
        reached = np.allclose(self.allocation @ squared, weight, atol=1e-9 * weight[2])
        if not reached:
            return np.full(self.n_rotors, np.nan)
        return np.sqrt(np.where(squared < 0.0, np.nan, squared))


NamedVehicle = Annotated[Vehicle, named("vehicle", Vehicle.load)]
"""A vehicle in a configuration: its fields, a preset's name, or the path of a YAML file."""
