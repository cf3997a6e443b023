# SPDX-License-Identifier: Apache-2.0
"""Tracks of a driver with habits in docs/yard.yaml, and what goes wrong with tracks."""

import numpy as np

START, GOAL = (4.0, 20.0), (56.0, 20.0)
NORTH_OF_HALL = [(34.0, 22.0), (36.5, 30.5), (48.5, 30.5)]
SOUTH_OF_HALL = [(36.0, 16.0), (48.0, 16.0)]
ROUTES = {
    'short': [(30.0, 18.5), (33.0, 18.0), *SOUTH_OF_HALL],
    'north': [(26.0, 24.0), (30.0, 34.5), (34.0, 34.5), (49.0, 31.0)],
    'hall': [(30.0, 19.5), (33.0, 20.0), *NORTH_OF_HALL],
    'south': [(15.0, 14.0), (30.0, 5.0), (33.0, 5.0), (50.0, 13.0)],
}
HABIT = ('hall', 'hall', 'north', 'hall', 'short', 'hall', 'hall', 'north')


def driven(name, rng, step=3.5, noise=0.25):
    """Positions (L, 2) of a receiver on one of ``ROUTES``, a step apart [m]."""
    corners = np.array([START, *ROUTES[name], GOAL])
    along = np.append(0.0, np.hypot(*np.diff(corners, axis=0).T).cumsum())
    at = np.append(np.arange(0.0, along[-1] - 0.5 * step, step), along[-1])
    line = np.column_stack([np.interp(at, along, axis) for axis in corners.T])
    return line + rng.normal(0.0, noise, line.shape)


def habit(weeks, seed=0):
    """Tracks of trips on ``HABIT``, week by week, the last one by the south gate."""
    rng = np.random.default_rng(seed)
    return [driven(name, rng) for name in (*HABIT * weeks, 'south')]


def yard_trips():
    """The text of docs/yard_trips.csv: three weeks, and four tracks that cannot be judged."""
    tracks = habit(3)
    tracks[4] = np.insert(tracks[4], 9, (300.0, -40.0), axis=0)  # an outlier
    tracks += [tracks[0][::-1], tracks[1][:12], np.delete(tracks[3], np.s_[5:13], axis=0)]
    times = [np.datetime64('2026-03-02T07:30') + np.timedelta64(day, 'D')
             + 2 * np.arange(len(track)).astype('timedelta64[s]')
             for day, track in enumerate(tracks)]
    times[-3] += np.timedelta64(9, 'h')
    tracks.append(tracks[6] + 0.2)  # the second vehicle of a convoy
    times.append(times[6] + np.timedelta64(4, 's'))
    rows = [f'{number},{time},{x:.2f},{y:.2f}\n'
            for number, (track, when) in enumerate(zip(tracks, times, strict=True), start=1)
            for time, (x, y) in zip(when, track, strict=True)]
    return 'track,time,x,y\n' + ''.join(rows)
