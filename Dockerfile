# The node of the last commit: git archive HEAD | docker build -t ambush_planner -
#                              docker run --rm --net=host ambush_planner
FROM ros:jazzy
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /ws
COPY . src/ambush_planner
# highspy, for faster plans, has no rosdep key.
# hadolint ignore=DL3008,DL3013
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-pip \
    && export PIP_BREAK_SYSTEM_PACKAGES=1 PIP_NO_CACHE_DIR=1 \
    && rosdep install -y --from-paths src --ignore-src --dependency-types exec \
    && pip install --no-cache-dir highspy \
    && source /opt/ros/jazzy/setup.bash \
    && colcon build \
    && rm -rf /var/lib/apt/lists/* build log
# Shared memory does not reach programs of other users, or outside of the container.
ENV FASTDDS_BUILTIN_TRANSPORTS=UDPv4
# The user ubuntu.
USER 1000
CMD ["/bin/bash", "-c", "source install/setup.bash && exec ros2 run ambush_planner ambush_planner"]
