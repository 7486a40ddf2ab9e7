# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""The command line as a process of its own, as its users start it."""

import subprocess
import sys

TIMEOUT_S = 120


def command(*arguments):
    return [sys.executable, "-m", "gtmr_study.cli", *map(str, arguments)]


def gtmr_process(*arguments, **options):
    return subprocess.run(
        command(*arguments), capture_output=True, text=True, timeout=TIMEOUT_S, check=False,
        **options,
    )  # fmt: skip
