"""Numbers that follow from poses: bone lengths, joint angles, speeds, contacts with the floor."""
