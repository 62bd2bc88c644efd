"""Head models behind ``model``, by name in ``registry``; identity, pose, expression, skin, hair and eyes."""
