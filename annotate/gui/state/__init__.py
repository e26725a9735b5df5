"""State of the correction window without Qt: scene, camera, drawing, edits, frame order."""
