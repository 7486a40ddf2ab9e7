# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What times the loop between real nodes still fits them."""

import json
import subprocess
import sys
from pathlib import Path

BENCH = Path(__file__).parents[2] / "bench" / "node_latency.py"


def test_the_loop_between_real_nodes_is_timed():
    run = subprocess.run(
        [sys.executable, BENCH, "--minutes", "0.05"], capture_output=True, text=True, timeout=60
    )

    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout[run.stdout.index("{\n") :])
    assert told["commands"] > 60
    assert 0.0 < told["latency_ms"]["median"] <= told["latency_ms"]["max"]
