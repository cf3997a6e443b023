# SPDX-License-Identifier: Apache-2.0
"""GeoTIFFs as other programs write them."""

import rasterio
from rasterio.enums import ColorInterp

# Places of the north-west corner and the cells, as rasterio.Affine takes them.
SQUARE = (30.0, 0.0, 7.4e5, 0.0, -30.0, 4.05e6)
UTM = 'EPSG:32616'


def write_geotiff(path, values, crs=UTM, place=SQUARE, nodata=None, alpha=None, **declared):
    """Write a raster, the north first, and what its band declares.

    That is its scale, offset, unit, description and colours; other keys are tags.
    """
    bands = [values] if alpha is None else [values, alpha]
    with rasterio.open(path, 'w', driver='GTiff', height=values.shape[0], width=values.shape[1],
                       count=len(bands), dtype=values.dtype, crs=crs, nodata=nodata,
                       transform=rasterio.Affine(*place)) as file:
        for k, band in enumerate(bands, start=1):
            file.write(band, k)
        file.scales = (declared.pop('scale', 1.0),) * len(bands)
        file.offsets = (declared.pop('offset', 0.0),) * len(bands)
        if alpha is not None:
            file.colorinterp = (ColorInterp.gray, ColorInterp.alpha)
        if colours := declared.pop('colours', None):
            file.write_colormap(1, colours)
        if unit := declared.pop('unit', ''):
            file.units = (unit,)
        if name := declared.pop('description', ''):
            file.set_band_description(1, name)
        file.update_tags(1, **declared)
    return path
