/* Fits a model to a photo and prints the fit's fingerprint, with no memory but static arrays:
 *
 *   example MODEL.3dmm PHOTO.ppm PHOTO.tlms
 */
#include "onescan.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Sizes this program is made for; a smaller model or photo fits, too. */
enum { VERTICES = 960, RANK = 30, SIDE = 64, LANDMARKS = 48, MODEL_BYTES = 512 * 1024 };

static uint32_t model[MODEL_BYTES / 4];
static uint8_t rgb[3 * SIDE * SIDE];
static uint32_t memory[ONESCAN_WORDS(VERTICES, RANK, RANK, LANDMARKS, SIDE, SIDE, 1)];
static char names[LANDMARKS][64];
static OnescanLandmark landmarks[LANDMARKS];
static OnescanFit fit;

static void check(OnescanStatus status, const char *what)
{
    if (status != ONESCAN_STATUS_OK) {
        fprintf(stderr, "%s: %s\n", what, onescan_status_text(status));
        exit(1);
    }
}

static FILE *open(const char *path)
{
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        perror(path);
        exit(1);
    }
    return file;
}

int main(int argc, char **argv)
{
    if (argc != 4) {
        fprintf(stderr, "usage: example MODEL.3dmm PHOTO.ppm PHOTO.tlms\n");
        return 2;
    }

    FILE *file = open(argv[1]);
    size_t model_bytes = fread(model, 1, sizeof model, file);
    fclose(file);
    OnescanModelInfo info;
    check(onescan_model_info((const uint8_t *)model, model_bytes, &info), argv[1]);

    unsigned width, height;
    file = open(argv[2]);
    if (fscanf(file, "P6 %u %u 255", &width, &height) != 2 || fgetc(file) != '\n' ||
        width > SIDE || height > SIDE || fread(rgb, 3, width * height, file) != width * height) {
        fprintf(stderr, "%s: not a binary PPM of at most %d x %d pixels\n", argv[2], SIDE, SIDE);
        return 1;
    }
    fclose(file);

    size_t count = 0;
    int visible;
    file = open(argv[3]);
    while (count < LANDMARKS && fscanf(file, "%63s %d %f %f", names[count], &visible,
                                       &landmarks[count].x, &landmarks[count].y) == 4) {
        landmarks[count].name = names[count];
        count += visible > 0;
    }
    fclose(file);

    OnescanSettings settings = onescan_default_settings();
    settings.shape_rank = settings.albedo_rank = RANK;
    settings.landmark_samples = 1000;
    settings.samples = 2000;
    settings.landmark_sd = 1;
    settings.pixel_patch = 5;
    settings.lean = true;
    size_t words = onescan_words(&info, &settings, count, width, height);
    if (words != ONESCAN_WORDS(info.vertices, RANK, RANK, count, width, height, 1)) {
        fprintf(stderr, "ONESCAN_WORDS differs from onescan_words: %zu\n", words);
        return 1;
    }
    settings.lean = false;
    if (onescan_words(&info, &settings, count, width, height) !=
        ONESCAN_WORDS(info.vertices, RANK, RANK, count, width, height, 0)) {
        fprintf(stderr, "ONESCAN_WORDS differs from onescan_words for a fit that is not lean\n");
        return 1;
    }
    settings.lean = true;
    check(onescan_start(&fit, (const uint8_t *)model, model_bytes, rgb, width, height, landmarks,
                        count, &settings, memory, sizeof memory / sizeof *memory),
          "cannot start");

    OnescanProgress progress;
    while (onescan_step(&fit, 500) > 0) {
        check(onescan_progress(&fit, &progress), "progress");
        fprintf(stderr, "%u of %u steps\n", progress.done, progress.total);
    }
    printf("fingerprint %016llx\n", (unsigned long long)progress.fingerprint);
    return 0;
}
