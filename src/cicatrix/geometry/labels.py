"""Tissue labels of a segmented image."""

from enum import IntEnum


class Label(IntEnum):
    """Tissue of a voxel: 0 to 4 are the values of imported label maps, 5 is the chest, to which the breast is attached."""

    AIR = 0
    FAT = 1
    GLAND = 2
    SKIN = 3
    TUMOUR = 4
    CHEST = 5


TISSUES = (Label.FAT, Label.GLAND, Label.SKIN, Label.TUMOUR)  # channels of a probability volume, in this order
