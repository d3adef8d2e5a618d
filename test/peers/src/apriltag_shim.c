/* AprilTag 3 behind four plain functions, so that no C struct layout is repeated in Rust. */
#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>
#include <stdint.h>
#include <stdlib.h>

typedef struct {
    apriltag_detector_t *detector;
    apriltag_family_t *family;
} Shim;

void *shim_apriltag_new(float decimate) {
    Shim *shim = malloc(sizeof(Shim));
    if (!shim) return NULL;
    shim->family = tag36h11_create();
    shim->detector = apriltag_detector_create();
    apriltag_detector_add_family(shim->detector, shim->family);
    shim->detector->nthreads = 1;
    shim->detector->quad_decimate = decimate;
    return shim;
}

/* Finds the corners of the tag `id`: x0, y0 … x3, y3, in the order (-1,1), (1,1), (1,-1), (-1,-1)
* of the ideal tag. Returns 1 if it was found. */
int shim_apriltag_detect(void *handle, uint8_t *gray, int32_t width, int32_t height, int32_t stride,
int id,
                         double corners[8]) {
    Shim *shim = handle;
    image_u8_t image = {.width = width, .height = height, .stride = stride, .buf = gray};
    zarray_t *found = apriltag_detector_detect(shim->detector, &image);
    int hit = 0;
    for (int i = 0; i < zarray_size(found); i++) {
        apriltag_detection_t *detection;
        zarray_get(found, i, &detection);
        if (detection->id == id && !hit) {
            hit = 1;
            for (int c = 0; c < 4; c++) {
                corners[2 * c] = detection->p[c][0];
                corners[2 * c + 1] = detection->p[c][1];
            }
        }
    }
    apriltag_detections_destroy(found);
    return hit;
}

/* The tag's image with its white border, 10x10 cells, a byte each. Returns 0 for another size. */
int shim_apriltag_frame(int id, uint8_t cells[100]) {
    apriltag_family_t *family = tag36h11_create();
    image_u8_t *frame = apriltag_to_image(family, id);
    int ok = frame && frame->width == 10 && frame->height == 10;
    for (int y = 0; ok && y < 10; y++)
        for (int x = 0; x < 10; x++) cells[10 * y + x] = frame->buf[y * frame->stride + x];
    if (frame) image_u8_destroy(frame);
    tag36h11_destroy(family);
    return ok;
}

void shim_apriltag_free(void *handle) {
    Shim *shim = handle;
    apriltag_detector_destroy(shim->detector);
    tag36h11_destroy(shim->family);
    free(shim);
}
