# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Packages of npm, installed once in a test run."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

INSTALL_TIMEOUT_S = 60
QUIET = ("--no-audit", "--no-fund", "--ignore-scripts", "--prefer-offline", "--silent")


def installed(folder: Path, *packages: str) -> Path:
    """Install packages into a folder, or skip the test where npm cannot."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("needs Node.js and npm")
    (folder / "package.json").write_text('{"private": true}')
    try:
        subprocess.run(
            [npm, "install", *QUIET, *packages],
            cwd=folder, check=True, capture_output=True, timeout=INSTALL_TIMEOUT_S,
        )  # fmt: skip
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        pytest.skip(f"npm cannot install {' '.join(packages)}, perhaps offline: {error}")
    return folder
