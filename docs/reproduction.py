# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Take over two reproductions: ``python docs/reproduction.py DEFAULT_DIR PAPER_CLOSEST_DIR``.

The folders are those of ``gtmr reproduce --seed 1``, without and with
``--scenario paper-closest``. Copies what docs/reproduction/ keeps of each, and renews the two
tables of docs/reproduction.md; its text is for a person to check.
"""

import gzip
import json
import re
import shutil
import sys
from pathlib import Path

from gtmr_study.campaign.trials_file import read_study
from gtmr_study.paper.claims_table import claims, claims_markdown, markdown_table
from gtmr_study.paper.report.tables import size_of_the_tightening
from gtmr_study.paper.reproduce import RESULTS_FILE

DOCS = Path(__file__).parent
NAMES = ("default", "paper-closest")
PAGE = DOCS / "reproduction.md"


def take_over(folder: Path, name: str) -> None:
    """Copy what is kept; trials are compressed."""
    kept = DOCS / "reproduction" / name
    for path in sorted(kept.iterdir()):
        if path.suffix != ".gz":
            shutil.copyfile(folder / path.name, path)
    (kept / "trials.csv.gz").write_bytes(
        gzip.compress((folder / "trials.csv").read_bytes(), mtime=0)
    )


def renew_table(text: str, table: str) -> str:
    """Put a table in the place of the one with the same first columns."""
    first = " | ".join(table.split(" | ")[:2])
    pattern = re.compile(rf"^{re.escape(first)} .*\n(?:\|.*\n)*", re.MULTILINE)
    renewed, found = pattern.subn(lambda _: table, text)
    if found != 1:
        raise SystemExit(f"{PAGE}: {found} tables begin with {first}")
    return renewed


def main() -> None:
    """Copy, and renew the tables."""
    results, found = {}, {}
    for folder, name in zip(map(Path, sys.argv[1:]), NAMES, strict=True):
        take_over(folder, name)
        results[name] = json.loads((folder / RESULTS_FILE).read_text(encoding="utf-8"))
        found[name] = claims(read_study(folder), results[name])
    text = renew_table(PAGE.read_text(encoding="utf-8"), claims_markdown(found))
    text = renew_table(text, markdown_table(size_of_the_tightening(results["default"])))
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
