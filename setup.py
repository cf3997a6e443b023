# SPDX-License-Identifier: Apache-2.0
"""Build and installation with colcon (ament_python), and with pip for the commands in bin/."""

import sys
from atexit import register
from glob import glob
from pathlib import Path
from tempfile import TemporaryDirectory

from setuptools import find_packages, setup

package_name = 'ambush_planner'
# mcap with its compressions.
recordings = ['mcap>=1.2.2', 'mcap-ros2-support>=0.5.3', 'lz4>=4.0', 'zstandard>=0.19']
gis = ['geopandas>=1.0', 'gpxpy>=1.5', 'mgrs>=1.4.6', 'pyogrio>=0.7', 'pyproj>=3.4',
       'rasterio>=1.3', 'shapely>=2.0']

# A package index has neither the pictures nor the pages that README.md links to.
introduction = Path('README.md').read_text(encoding='utf-8').split('\n## ')[0]
introduction = '\n'.join(line for line in introduction.splitlines() if not line.startswith('!['))
introduction += '\n\nBegin with `ambush plan --help`.\n'

# pip builds in the checkout; its build results go to a temporary folder.
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
    long_description=introduction,
    long_description_content_type='text/markdown',
    maintainer='ambush_planner maintainers',
    maintainer_email='maintainers@ambush-planner.invalid',
    license='Apache-2.0',
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    packages=find_packages(include=[package_name, f'{package_name}.*']),
    package_data={package_name: ['py.typed', 'recordings/definitions.json', *(
        f'commands/*.{kind}' for kind in ('css', 'html', 'qml'))]},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        (f'share/{package_name}/config', sorted(glob('config/*'))),
        (f'share/{package_name}/launch', sorted(glob('launch/*'))),
        (f'share/{package_name}/msg_examples', sorted(glob('msg_examples/*.yaml'))),
    ],
    zip_safe=False,
    python_requires='>=3.10',
    # rclpy and the messages come from apt on a ROS machine (package.xml), elsewhere from the extra
    # `jazzy`.
    install_requires=[
        'numpy>=1.26.4',
        'scipy>=1.11.4',
        'highspy>=1.8',
        'PyYAML>=6.0',
        'threadpoolctl>=3.1',
    ],
    extras_require={
        # The metapackages pin the distribution; unpinned ros-rclpy would bring a newer one.
        'jazzy': ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces', *recordings],
        # Reading recordings without ROS.
        'recordings': recordings,
        'figures': ['matplotlib>=3.6.3'],
        # latex2mathml draws formulas without a script from the network.
        'docs': ['furo>=2024.8', 'latex2mathml>=3.77', 'myst-parser>=3', 'sphinx>=7.3'],
        # Coordinate systems; GeoTIFF, GeoPackage, GeoJSON, GPX.
        'gis': gis,
        # colcon test runs pytest only if an extra of this name has it.
        'test': [
            *gis,
            'networkx>=2.8',
            'behaviortreepy',  # BehaviorTree.CPP's parser
            'pytest>=7.4',
            'pytest-timeout',
            'pytest-xdist',
            'hypothesis',
            'latex2mathml',  # parses the formulas of the documents
            'clarabel',
            'distributed>=2024.1',  # an executor for solve_many
            'rosbags',
            'setuptools>=70.1',  # makes wheels without the package wheel
        ],
        'lint': ['ruff>=0.17,<0.18', 'mypy>=2.4,<3'],
    },
    entry_points={
        'console_scripts': [
            'ambush_planner = ambush_planner.ros.program:main',
            'ambush = ambush_planner.commands:main',
        ],
    },
)
