"""What runs inside Blender (a Python that has `bpy`): import a USD file, render its cameras with Cycles.

    python blender_child.py JOB.json

A program of its own: it imports nothing of this project. The job names the file, the samples and for each picture the
camera, its size and where the EXR goes. `script` is Python run after the import, with `bpy` and the job's `values`.
"""

import json
import sys


def main(job_file: str) -> None:
    import bpy

    with open(job_file, encoding="utf-8") as file:
        job = json.load(file)
    # The start-up scene, emptied: without its World the importer drops the dome light.
    bpy.ops.wm.read_factory_settings(use_empty=False)
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    done = bpy.ops.wm.usd_import(filepath=job["usd"])
    if "FINISHED" not in done:
        raise SystemExit(f"Blender did not import {job['usd']}: {done}")
    if job["script"]:
        exec(job["script"], {"bpy": bpy, "values": job["values"]})  # not in the key: the caller's own text
    scene = bpy.context.scene
    render = scene.render
    render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", job["samples"]
    scene.cycles.use_denoising, scene.cycles.pixel_filter_type = False, "BOX"
    scene.cycles.seed = job["seed"]
    render.threads_mode, render.threads = "FIXED", job["threads"]
    render.resolution_percentage, render.film_transparent = 100, job["transparent"]
    scene.view_settings.view_transform = "Raw"
    settings = render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
    if job["hide_meshes"]:
        for thing in bpy.data.objects:
            thing.hide_render = thing.type == "MESH"
    for picture in job["pictures"]:
        render.resolution_x, render.resolution_y = picture["width"], picture["height"]
        scene.camera = next(
            thing
            for thing in bpy.data.objects
            if thing.type == "CAMERA" and picture["camera"] in (thing.name, thing.data.name)
        )
        render.filepath = picture["file"]
        bpy.ops.render.render(write_still=True)
    if job["save"]:
        bpy.ops.wm.save_as_mainfile(filepath=job["save"])


if __name__ == "__main__":
    main(sys.argv[1])  # not in the key: the job that the caller wrote
