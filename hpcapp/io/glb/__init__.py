"""Binary glTF: meshes to be shown."""
