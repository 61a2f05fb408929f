// The libraries that pages draw with; a bundle of their own, for they seldom change.
import "@kitware/vtk.js/Rendering/Profiles/Geometry";
import vtkActor from "@kitware/vtk.js/Rendering/Core/Actor";
import vtkColorTransferFunction from "@kitware/vtk.js/Rendering/Core/ColorTransferFunction";
import vtkDataArray from "@kitware/vtk.js/Common/Core/DataArray";
import vtkGenericRenderWindow from "@kitware/vtk.js/Rendering/Misc/GenericRenderWindow";
import vtkInteractorStyleManipulator from "@kitware/vtk.js/Interaction/Style/InteractorStyleManipulator";
import vtkMapper from "@kitware/vtk.js/Rendering/Core/Mapper";
import vtkMouseCameraTrackballPanManipulator from "@kitware/vtk.js/Interaction/Manipulators/MouseCameraTrackballPanManipulator";
import vtkMouseCameraTrackballZoomManipulator from "@kitware/vtk.js/Interaction/Manipulators/MouseCameraTrackballZoomManipulator";
import vtkPolyData from "@kitware/vtk.js/Common/DataModel/PolyData";
import { NVImage, Niivue, SLICE_TYPE, SHOW_RENDER } from "@niivue/niivue";
import * as Plot from "@observablehq/plot";

export const vtk = {
  Actor: vtkActor, ColorTransferFunction: vtkColorTransferFunction, DataArray: vtkDataArray, GenericRenderWindow: vtkGenericRenderWindow,
  InteractorStyleManipulator: vtkInteractorStyleManipulator, Mapper: vtkMapper, Pan: vtkMouseCameraTrackballPanManipulator,
  PolyData: vtkPolyData, Zoom: vtkMouseCameraTrackballZoomManipulator,
};
export { NVImage, Niivue, Plot, SHOW_RENDER, SLICE_TYPE };
