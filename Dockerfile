# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
#
# ROS 2 Jazzy with hnn_vi_ros, built by colcon and run by an ordinary user:
#   docker build -t hnn_vi_ros .
#   docker run --rm -it hnn_vi_ros
FROM ros:jazzy-ros-base

# Not -u: the setup files of ROS read variables that are not set.
SHELL ["/bin/bash", "-eo", "pipefail", "-c"]

# Python packages are pinned; those of Ubuntu and ROS are the ones of the base image's day.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends make python3-venv ros-jazzy-rmw-fastrtps-cpp \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home --shell /bin/bash hnn

USER hnn
WORKDIR /home/hnn/hnn_vi_ros

# What is downloaded is a layer of its own, which changes of the sources leave as it is.
COPY --chown=hnn:hnn requirements requirements
RUN source /opt/ros/jazzy/setup.bash \
    && requirements/make_venv run \
    && rm -rf /home/hnn/.cache/pip

COPY --chown=hnn:hnn . .
RUN source /opt/ros/jazzy/setup.bash \
    && make build \
    && mkdir /home/hnn/work

# Runs are written here.
WORKDIR /home/hnn/work
ENTRYPOINT ["/bin/bash", "-c", "source /home/hnn/hnn_vi_ros/install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "run", "hnn_vi_ros", "simulator", "--ros-args", "-p", "scene:=double_pendulum", "-p", "duration:=20.0"]
