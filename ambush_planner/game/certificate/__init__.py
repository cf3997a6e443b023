# SPDX-License-Identifier: Apache-2.0
"""The judge: value and lower bound from a strategy and an ambusher alone."""
