# SPDX-License-Identifier: Apache-2.0
"""The route distribution: the most unpredictable strategy within limits, on an acyclic network."""
