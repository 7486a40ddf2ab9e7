# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Feeds a recorded flight to the controller again, and compares what it commands."""

from gtmr_study.replay.recording import Recording, read_recording
from gtmr_study.replay.result import Replay, Step
from gtmr_study.replay.run import replay

__all__ = ["Recording", "Replay", "Step", "read_recording", "replay"]
