# SPDX-License-Identifier: Apache-2.0
"""The law of routes: the most unpredictable strategy within limits, on an acyclic network."""
