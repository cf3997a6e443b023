# SPDX-License-Identifier: Apache-2.0
"""The least value, and an ambusher who proves it: by a cut, face potentials, or whole routes.

``linear_program`` has the paper's own LPs.
"""
