# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The command ``gtmr export-c``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gtmr_model import Vehicle
from gtmr_model.compile import CompileError
from gtmr_nmpc import ControllerConfig
from gtmr_study.export_c import export_c
from gtmr_study.result_files import InputError, require_empty_folder
from gtmr_study.terminal import console


def export_c_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder.")],
    controller: Annotated[
        str, typer.Option(metavar="NAME|YAML", help="Preset or file under config/controller.")
    ] = "default",
    vehicle: Annotated[
        str | None, typer.Option(metavar="NAME|YAML", help="Preset or file under config/vehicle.")
    ] = None,
) -> None:
    """Write the controller as plain C99, with a build file and a replay that checks it."""
    require_empty_folder("DIR", folder)
    config = ControllerConfig.load("controller", controller)
    if vehicle is not None:
        config = config.model_copy(update={"vehicle": Vehicle.load("vehicle", vehicle)})
    try:
        written = export_c(config, "robust", folder)
    except CompileError as error:
        raise InputError(str(error)) from None
    console.print(
        f"{len(written)} files in {folder}; the interface is gtmr.h. Build and check with\n"
        f"  cmake -S {folder} -B {folder}/build && cmake --build {folder}/build && "
        f"{folder}/build/replay {folder}/flight.csv",
        soft_wrap=True,
    )
