"""The forward model, effect by effect, and the simulated devices built on it.

A simulated bench is composed of four things (`radiometer.bench` does it from a configuration file):

    preset = CameraPreset.shipped("BFS-U3-19S4M")                    # radiometer.devices; or CameraPreset.read(path)
    lens = LensDescription(focal_length_mm=16, f_number=4.0)         # radiometer.data
    scene = scene_from_mapping({"kind": "screen", ...}, where, folder)
    model = CameraModel.ideal(preset.camera, lens)                   # or CameraModel.read(path) for a reconciled one
    camera = SimulatedCamera(model, scene, seed=0, serial="22500001",
                             limits=preset.require_limits(where).capabilities(has_shutter=True))

Effects (`simulators.effects`) are the entries of the model.
Nothing here imports `radiometer.analysis`: the formula that makes the light must not be the one that measures it.
"""
