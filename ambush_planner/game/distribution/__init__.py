# SPDX-License-Identifier: Apache-2.0
"""The route distribution: the strategy of greatest entropy within caps, on an acyclic network."""
