"""Build and installation, with colcon (ament_python) and with pip."""

import sys
from atexit import register
from glob import glob
from tempfile import TemporaryDirectory

from setuptools import find_packages, setup

package_name = 'ambush_planner'

data_files = [
    ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
    (f'share/{package_name}', ['package.xml']),
    (f'share/{package_name}/config', sorted(glob('config/*'))),
    (f'share/{package_name}/launch', sorted(glob('launch/*'))),
    (f'share/{package_name}/msg_examples', sorted(glob('msg_examples/*.yaml'))),
]
# `ros2 run` looks for executables in lib/<package>. colcon puts them there (setup.cfg), pip puts
# them in bin/, so a wheel brings launchers. Under colcon they would overwrite the real ones.
if 'bdist_wheel' in sys.argv:
    data_files.append((f'lib/{package_name}', sorted(glob('launchers/*'))))

# pip builds in the checkout. What it would leave there goes to a folder that vanishes; colcon names
# its own folders.
options = {}
if {'egg_info', 'dist_info', 'bdist_wheel', 'editable_wheel'} & set(sys.argv[1:]):
    scratch = TemporaryDirectory()
    register(scratch.cleanup)
    options = {'build': {'build_base': scratch.name}, 'egg_info': {'egg_base': scratch.name}}

setup(
    name=package_name,
    options=options,
    version='0.1.0',
    description='Random routes that an ambusher cannot foresee, for ROS 2',
    maintainer='ambush_planner maintainers',
    maintainer_email='maintainers@ambush-planner.invalid',
    license='Apache-2.0',
    packages=find_packages(include=[package_name, f'{package_name}.*']),
    package_data={package_name: [f'commands/*.{kind}' for kind in (
        'css', 'html', 'js', 'json', 'rviz',
    )]},
    data_files=data_files,
    zip_safe=False,
    python_requires='>=3.10',
    # rclpy and the messages are not here: on a ROS machine they come from apt (package.xml),
    # elsewhere from the extra `jazzy`.
    install_requires=[
        'numpy>=1.26.4',
        'scipy>=1.11.4',
        'PyYAML>=6.0',
        'mcap>=1.2.2',
        'mcap-ros2-support>=0.5.3',
        # What mcap compresses with; chunks are unpacked by these, with a bound on their size.
        'lz4>=4.0',
        'zstandard>=0.19',
    ],
    extras_require={
        # The metapackages pin the distribution; unpinned ros-rclpy would bring a newer one.
        'jazzy': ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces'],
        'figures': ['matplotlib>=3.6.3'],
        # ambush_terrain reads GeoTIFF, ambush_table solves on a cluster.
        'terrain': ['rasterio>=1.3'],
        'dask': ['distributed>=2024.1'],
        # Words of `ambush` completed in the shell, after register-python-argcomplete.
        'completion': ['argcomplete'],
        # colcon test runs pytest only because it stands in an extra of this name.
        'test': [
            'argcomplete',
            'pytest>=7.4',
            'pytest-timeout',
            'pytest-xdist',
            'hypothesis',
            'networkx',
            'highspy',
            'clarabel',
            'distributed>=2024.1',
            'rasterio>=1.3',
            'rosbags',
            'setuptools>=70.1',  # makes wheels by itself
        ],
        'lint': ['ruff>=0.17,<0.18', 'mypy>=2.4,<3'],
    },
    entry_points={
        'console_scripts': [
            'ambush_planner = ambush_planner.ros.planner_node:main',
            # One program: its name, or its first argument, says which command it is.
            *(
                f'{name} = ambush_planner.commands.cli:main'
                for name in (
                    'ambush', 'ambush_audit', 'ambush_demo', 'ambush_frontier',
                    'ambush_replay', 'ambush_report', 'ambush_table', 'ambush_terrain',
                    'ambush_verify', 'ambush_views',
                )
            ),
        ],
    },
)
