"""What a file is, in words for outputs: names of files and folders may be those of patients and are not passed on."""

from __future__ import annotations

from pathlib import Path

from .dicom_mark import is_dicom

KINDS = {  # by the ending of the name
    ".nii.gz": "NIfTI image", ".nii": "NIfTI image", ".hdr": "NIfTI image", ".img": "NIfTI image",
    ".nrrd": "NRRD image", ".nhdr": "NRRD image", ".mha": "MetaImage", ".mhd": "MetaImage", ".dcm": "DICOM image",
    ".vtu": "VTU mesh", ".pvtu": "VTU mesh", ".vtk": "VTK mesh", ".msh": "Gmsh mesh", ".inp": "Abaqus mesh",
    ".npy": "NumPy array", ".npz": "NumPy arrays", ".csv": "CSV table", ".tsv": "TSV table", ".xlsx": "Excel workbook",
    ".xml": "SBML network", ".sbml": "SBML network", ".toml": "TOML file", ".json": "JSON file", ".txt": "text file",
}  # fmt: skip


def bare_name(path: Path) -> str:
    """Return what a file or folder is, without its name: "NIfTI image", "DICOM folder, 49 files", or "file"."""
    if path.is_dir():
        files = [file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")]
        kind = "DICOM folder" if any(is_dicom(_head(file)) for file in files) else "folder"
        return f"{kind}, {len(files)} file{'s' if len(files) != 1 else ''}"
    name = path.name.lower()
    known = next((kind for ending, kind in KINDS.items() if name.endswith(ending)), None)
    return known or ("DICOM image" if path.is_file() and is_dicom(_head(path)) else "file")


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(132)
