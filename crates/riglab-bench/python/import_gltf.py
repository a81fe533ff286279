"""Blender's glTF importer, one file after the other in one process."""

import time

import bpy

from serve import peak_memory_mb, serve


def read(files):
    """Seconds spent in the importer for all files, and those that it refused.

    The scene is emptied before each file, outside the time that counts.
    """
    seconds, refused = 0.0, []
    for file in files:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        start = time.perf_counter()
        try:
            # Errors only: printing what it does would cost it time.
            bpy.ops.import_scene.gltf(filepath=file, loglevel=40)
        except Exception:
            refused.append(file)
        seconds += time.perf_counter() - start
    return {"seconds": seconds, "refused": refused, "memory_mb": peak_memory_mb()}


serve({"read": read})
