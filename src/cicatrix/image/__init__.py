"""Segmentation of medical images: from voxels to tissue labels and probabilities."""
