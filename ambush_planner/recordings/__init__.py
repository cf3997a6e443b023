# SPDX-License-Identifier: Apache-2.0
"""Recordings of departures: MCAP files that rosbag2 and Foxglove take, and what is read from them.

``recorder`` writes a departure's messages, metadata and strategy as one file. ``recording_file``
reads the file, ``recorded_departure`` holds what the departure was drawn from, ``verify`` checks
that the recorded route and path follow from it. Nothing here needs a ROS node; reading and
verifying need no ROS installation.
"""
