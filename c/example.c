/* Fits a model to a photo and prints the fit's fingerprint, with no memory but static arrays:
 *
 *   example MODEL.3dmm PHOTO.ppm PHOTO.tlms          searches for the mode of the posterior
 *   example MODEL.3dmm PHOTO.ppm PHOTO.tlms chain    runs the paper's chain
 */
#include "onescan.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Sizes this program is made for; a smaller model or photo fits, too. */
enum {
    VERTICES = 960,
    TRIANGLES = 2 * VERTICES,
    RANK = 30,
    SEARCH_RANK = 20,
    SIDE = 64,
    LANDMARKS = 48,
    MODEL_BYTES = 512 * 1024
};

static uint32_t model[MODEL_BYTES / 4];
static uint8_t rgb[3 * SIDE * SIDE];
static uint32_t memory[ONESCAN_SEARCH_WORDS(VERTICES, TRIANGLES, RANK, RANK, LANDMARKS, SIDE,
                                            SIDE, 1)];
static size_t model_bytes, count;
static unsigned width, height;
static OnescanModelInfo info;
static OnescanSettings settings;
static char names[LANDMARKS][64];
static OnescanLandmark landmarks[LANDMARKS];

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

static void search(void)
{
    settings.shape_rank = settings.albedo_rank = SEARCH_RANK;
    settings.lean = true;
    static OnescanSearch search;
    static OnescanScene scene;
    size_t words = onescan_search_words(&info, &settings, count, width, height);
    if (words != ONESCAN_SEARCH_WORDS(info.vertices, info.triangles, SEARCH_RANK, SEARCH_RANK, count,
                                      width, height, 1)) {
        fprintf(stderr, "ONESCAN_SEARCH_WORDS differs from onescan_search_words: %zu\n", words);
        exit(1);
    }
    check(onescan_search_start(&search, (const uint8_t *)model, model_bytes, rgb, width, height,
                               landmarks, count, &settings, memory, sizeof memory / sizeof *memory),
          "cannot start");

    OnescanSearchProgress progress;
    while (onescan_search_step(&search, 1) > 0) {
        check(onescan_search_progress(&search, &progress), "progress");
        fprintf(stderr, "step %u of at most %u, energy %.1f\n", progress.done, progress.most,
                progress.energy);
    }
    check(onescan_search_scene(&search, &scene), "scene");
    const float *mask = onescan_search_mask(&search);
    size_t seen = 0;
    for (size_t i = 0; i < (size_t)width * height; i++)
        seen += mask[i] > 0.5f;
    fprintf(stderr, "%s; yaw %.3f, first shape coefficient %.2f, %zu pixels show the face\n",
            progress.converged ? "converged" : "not converged", scene.yaw, scene.shape[0], seen);
    printf("search %016llx\n", (unsigned long long)progress.fingerprint);
}

static void chain(void)
{
    static OnescanFit fit;
    settings.shape_rank = settings.albedo_rank = RANK;
    settings.landmark_samples = 1000;
    settings.samples = 2000;
    size_t words = onescan_words(&info, &settings, count, width, height);
    if (words != ONESCAN_WORDS(info.vertices, RANK, RANK, count, width, height, 0)) {
        fprintf(stderr, "ONESCAN_WORDS differs from onescan_words: %zu\n", words);
        exit(1);
    }
    settings.lean = true;
    if (onescan_words(&info, &settings, count, width, height) !=
        ONESCAN_WORDS(info.vertices, RANK, RANK, count, width, height, 1)) {
        fprintf(stderr, "ONESCAN_WORDS differs from onescan_words for a lean chain\n");
        exit(1);
    }
    check(onescan_start(&fit, (const uint8_t *)model, model_bytes, rgb, width, height, landmarks,
                        count, &settings, memory, sizeof memory / sizeof *memory),
          "cannot start");

    OnescanProgress progress;
    while (onescan_step(&fit, 500) > 0) {
        check(onescan_progress(&fit, &progress), "progress");
        fprintf(stderr, "%u of %u steps\n", progress.done, progress.total);
    }
    printf("fingerprint %016llx\n", (unsigned long long)progress.fingerprint);
}

int main(int argc, char **argv)
{
    if (argc != 4 && argc != 5) {
        fprintf(stderr, "usage: example MODEL.3dmm PHOTO.ppm PHOTO.tlms [chain]\n");
        return 2;
    }

    FILE *file = open(argv[1]);
    model_bytes = fread(model, 1, sizeof model, file);
    if (fgetc(file) != EOF) {
        fprintf(stderr, "%s: more than %d bytes; raise MODEL_BYTES, or make it smaller by onescan export\n",
                argv[1], MODEL_BYTES);
        return 1;
    }
    fclose(file);
    check(onescan_model_info((const uint8_t *)model, model_bytes, &info), argv[1]);

    file = open(argv[2]);
    if (fscanf(file, "P6 %u %u 255", &width, &height) != 2 || fgetc(file) != '\n' ||
        width > SIDE || height > SIDE || fread(rgb, 3, width * height, file) != width * height) {
        fprintf(stderr, "%s: not a binary PPM of at most %d x %d pixels\n", argv[2], SIDE, SIDE);
        return 1;
    }
    fclose(file);

    int visible;
    file = open(argv[3]);
    while (count < LANDMARKS && fscanf(file, "%63s %d %f %f", names[count], &visible,
                                       &landmarks[count].x, &landmarks[count].y) == 4) {
        landmarks[count].name = names[count];
        count += visible > 0;
    }
    fclose(file);

    settings = onescan_default_settings();
    settings.landmark_sd = 1;
    settings.pixel_patch = 5;
    if (argc == 5)
        chain();
    else
        search();
    return 0;
}
