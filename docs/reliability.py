# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Renew the tables of docs/reliability.md: ``python docs/reliability.py FAULTS.json...``.

The files are those of ``gtmr faults --json``; of a fault that is in several the last counts.
"""

import json
import re
import sys
from pathlib import Path

from gtmr_study.faults.campaign import markdown

PAGE = Path(__file__).with_name("reliability.md")
PLACES = ("loop", "bytes", "files", "nodes")


def main() -> None:
    """Put each place's table between its markers."""
    rows = {}
    for name in sys.argv[1:]:
        for row in json.loads(Path(name).read_text(encoding="utf-8")):
            rows[row["fault"]] = row
    text = PAGE.read_text(encoding="utf-8")
    for place in PLACES:
        table = markdown([row for row in rows.values() if row["place"] == place])
        begin, end = f"<!-- {place} -->\n", "<!-- end -->"
        pattern = re.compile(f"{begin}.*?{end}", re.DOTALL)
        whole = f"{begin}\n{table}\n{end}"
        text, found = pattern.subn(lambda _, whole=whole: whole, text)
        if found != 1:
            raise SystemExit(f"{PAGE}: {found} places for {place}")
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
