"""Operations on images and maps: crop, mirror, camera, background, JPEG, affine moves."""
