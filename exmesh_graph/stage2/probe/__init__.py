"""What a scene needs, measured: `stage2.probe.scene.probe_scene`."""
