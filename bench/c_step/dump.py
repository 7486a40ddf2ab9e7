# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Write the C sources and parameters of the default problem, of the code in PYTHONPATH.

``python dump.py FOLDER``; works for old layouts of this repository as well.
"""

import sys
from pathlib import Path

from gtmr_nmpc import ControllerConfig

try:
    from gtmr_nmpc.compiled import codegen
    from gtmr_nmpc.compiled.iteration import parameters
except ImportError:
    from gtmr_nmpc import codegen
    from gtmr_nmpc.compiled import parameters

folder = Path(sys.argv[1])
sources = codegen.c_sources(ControllerConfig())
flags = codegen.flags(sources)
for name, text in sources.items():
    (folder / name).write_text(text, encoding="utf-8")
(folder / "flags").write_text(
    "\n".join(f"{name} {' '.join(flags[name])}" for name in flags), encoding="utf-8"
)
for tightening in ("frozen", "gradient"):
    config = ControllerConfig(tightening=tightening)
    few = (config,) if parameters.__code__.co_argcount == 1 else (config, False)
    (folder / f"{tightening}.parameters").write_bytes(bytes(parameters(*few)))
