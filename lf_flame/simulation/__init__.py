"""From a scene and a camera to a light field, with the effects that the scene calls for."""
