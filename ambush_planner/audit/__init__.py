"""Departures tested together against the strategies that they were drawn from; numpy, no ROS."""
