# SPDX-License-Identifier: Apache-2.0
"""The parameters of the node: one table of all, and their values as a frozen record."""
