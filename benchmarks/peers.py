# SPDX-License-Identifier: Apache-2.0
"""Linear programs by HiGHS (Huangfu and Hall, 2018): only its own run is timed, on one thread."""

from __future__ import annotations

import time
from typing import Any

import highspy
import numpy as np
from games import LP
from scipy.sparse import csc_matrix, vstack


def highs(lp: LP, **options: Any) -> dict[str, Any]:
    """HiGHS' status, its value, and its processor seconds."""
    model, rows = highspy.HighsLp(), csc_matrix(vstack((lp.above, lp.balance)))
    model.num_row_, model.num_col_ = rows.shape
    model.col_cost_, model.col_lower_ = lp.cost, np.zeros(rows.shape[1])
    model.col_upper_ = lp.most
    model.row_lower_ = np.r_[np.full(len(lp.limits), -np.inf), lp.supply]
    model.row_upper_ = np.r_[lp.limits, lp.supply]
    model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    model.a_matrix_.start_, model.a_matrix_.index_ = rows.indptr, rows.indices
    model.a_matrix_.value_ = rows.data
    engine = highspy.Highs()
    settings = {'output_flag': False, 'threads': 1, 'solver': 'simplex', **options}
    for name, setting in settings.items():
        engine.setOptionValue(name, setting)
    engine.passModel(model)
    begin = time.process_time()
    engine.run()
    seconds = time.process_time() - begin
    status = engine.modelStatusToString(engine.getModelStatus())
    answer = {'seconds': seconds, 'status': status}
    found = {'value': engine.getInfo().objective_function_value}
    return answer | (found if status == 'Optimal' else {'failed': True})
