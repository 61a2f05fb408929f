"""Tissue labels of a segmented image."""

from enum import IntEnum


class Label(IntEnum):
    """What a voxel is; 0 to 4 are the numbers of imported label maps, 5 marks the body that the breast hangs on."""

    AIR = 0
    FAT = 1
    GLAND = 2
    SKIN = 3
    TUMOUR = 4
    CHEST = 5


TISSUES = (Label.FAT, Label.GLAND, Label.SKIN, Label.TUMOUR)  # the channels of a probability volume, in order
