# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The style sheet of the report."""

STYLE = """
:root { color-scheme: light; }
body {
  max-width: 1080px; margin: 2.5rem auto 5rem; padding: 0 1.25rem;
  font: 16px/1.5 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif;
  color: #1a1a1a; background: #fff;
}
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 1.5rem; }
h2 { font-size: 1.3rem; line-height: 1.3; margin: 2.75rem 0 0.5rem; }
p { max-width: 46rem; margin: 0.25rem 0 0.75rem; color: #444; }
figure { margin: 0; break-inside: avoid; }
.tables { display: flex; flex-wrap: wrap; column-gap: 5rem; }
.tables section { min-width: 0; }
.tables h2 { margin-top: 0.5rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 0.22rem 1.4rem 0.22rem 0; text-align: left; font-weight: 400; }
tbody tr { border-top: 1px solid #e3e3e3; }
tbody th { color: #444; padding-right: 1.8rem; }
thead th { font-weight: 600; white-space: nowrap; }
.key {
  display: inline-block; width: 0.8em; height: 0.8em; margin-right: 0.45em; border-radius: 2px;
}
.bad { color: #a33c00; }
.warning {
  padding: 0.6rem 0.9rem; border-left: 4px solid #d55e00; background: #fdf1ea; color: #1a1a1a;
}
@media print { body { margin: 0; max-width: none; } }
"""
