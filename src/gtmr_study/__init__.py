# Copyright 2026 the gtmr authors
# SPDX-License-Identifier: Apache-2.0

"""Flights, demo, campaigns and the ``gtmr`` command line."""
