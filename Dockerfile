# The node of the last commit: git archive HEAD | docker build -t ambush_planner -
#                              docker run --rm --net=host ambush_planner
FROM ros:jazzy
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /ws
COPY . src/ambush_planner
# highspy, for faster plans, mcap-ros2-support, for recordings, and threadpoolctl are not in apt.
# hadolint ignore=DL3008,DL3013
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-pip \
    && rosdep install -y --from-paths src --ignore-src --dependency-types exec \
    && pip install --break-system-packages --no-cache-dir highspy mcap-ros2-support threadpoolctl \
    && source /opt/ros/jazzy/setup.bash \
    && colcon build \
    && rm -rf /var/lib/apt/lists/* build log
# Shared memory does not reach programs of other users, or outside of the container.
ENV FASTDDS_BUILTIN_TRANSPORTS=UDPv4
# The user ubuntu.
USER 1000
CMD ["/bin/bash", "-c", "source install/setup.bash && exec ros2 run ambush_planner ambush_planner"]
