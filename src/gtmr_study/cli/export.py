# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command ``gtmr export-c``."""

from pathlib import Path
from typing import Annotated

import typer

from gtmr_codegen.library import CompileError
from gtmr_model import Vehicle
from gtmr_nmpc import ControllerConfig
from gtmr_study.cli.terminal import VehicleOption, console, option
from gtmr_study.export.project import export_c
from gtmr_study.result_files import InputError, require_empty_folder


def export_c_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder.")],
    controller: Annotated[
        str, option("NAME|YAML", "Controller: a preset or a file.", "default")
    ] = "default",
    vehicle: VehicleOption = None,
) -> None:
    """Write controller and guard as plain C99, with a build file and a replay that checks it."""
    require_empty_folder("DIR", folder)
    config = ControllerConfig.load("controller", controller)
    if vehicle is not None:
        config = config.model_copy(update={"vehicle": Vehicle.load("vehicle", vehicle)})
    try:
        written = export_c(config, "robust", folder)
    except CompileError as error:
        raise InputError(str(error)) from None
    except OSError as error:
        raise InputError(f"DIR = {folder}: cannot be written: {error.strerror}") from None
    console.print(
        f"{len(written)} files in {folder}; the interface is gtmr.h and gtmr_guard.h. "
        "Build and check with\n"
        f"  cmake -S {folder} -B {folder}/build && cmake --build {folder}/build && "
        f"{folder}/build/replay {folder}/flight.csv {folder}/offset_free.csv "
        f"{folder}/guard.csv",
        soft_wrap=True,
    )
