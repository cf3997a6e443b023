# SPDX-License-Identifier: Apache-2.0
"""Value and lower bound from both sides' strategies alone, without the solver."""
