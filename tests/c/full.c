/* Fits a model of any size to a photo by default settings, with memory asked for while it runs, by a
 * chain and by a search, and prints their fingerprints: full MODEL.3dmm PHOTO.ppm PHOTO.tlms */
#include "onescan.h"

#include <stdio.h>
#include <stdlib.h>

static void *check(void *pointer, const char *what)
{
    if (pointer == NULL) {
        perror(what);
        exit(1);
    }
    return pointer;
}

static void good(OnescanStatus status)
{
    if (status != ONESCAN_STATUS_OK) {
        fprintf(stderr, "%s\n", onescan_status_text(status));
        exit(1);
    }
}

int main(int argc, char **argv)
{
    static char names[ONESCAN_MAX_LANDMARKS][64];
    static OnescanLandmark landmarks[ONESCAN_MAX_LANDMARKS];
    static OnescanFit fit;
    static OnescanSearch search;
    if (argc != 4)
        return 2;

    FILE *file = check(fopen(argv[1], "rb"), argv[1]);
    fseek(file, 0, SEEK_END);
    size_t bytes = (size_t)ftell(file);
    rewind(file);
    uint8_t *model = check(malloc(bytes), "model");
    if (fread(model, 1, bytes, file) != bytes)
        return 1;
    fclose(file);
    OnescanModelInfo info;
    good(onescan_model_info(model, bytes, &info));

    unsigned width, height;
    file = check(fopen(argv[2], "rb"), argv[2]);
    if (fscanf(file, "P6 %u %u 255", &width, &height) != 2 || fgetc(file) != '\n')
        return 1;
    uint8_t *rgb = check(calloc((size_t)width * height, 3), "photo");
    if (fread(rgb, 3, (size_t)width * height, file) != (size_t)width * height)
        return 1;
    fclose(file);

    size_t count = 0;
    int visible;
    file = check(fopen(argv[3], "rb"), argv[3]);
    while (count < ONESCAN_MAX_LANDMARKS &&
           fscanf(file, "%63s %d %f %f", names[count], &visible, &landmarks[count].x,
                  &landmarks[count].y) == 4) {
        landmarks[count].name = names[count];
        count += visible > 0;
    }
    fclose(file);

    OnescanSettings settings = onescan_default_settings();
    settings.pixel_patch = 1; /* the paper's chain: one pixel, one error */
    size_t words = onescan_words(&info, &settings, count, width, height);
    uint32_t *memory = check(calloc(words, sizeof *memory), "memory");
    good(onescan_start(&fit, model, bytes, rgb, width, height, landmarks, count, &settings, memory,
                       words));
    while (onescan_step(&fit, 500) > 0) {
    }
    OnescanProgress progress;
    good(onescan_progress(&fit, &progress));
    printf("fingerprint %016llx\n", (unsigned long long)progress.fingerprint);
    free(memory);

    settings = onescan_default_settings();
    words = onescan_search_words(&info, &settings, count, width, height);
    memory = check(calloc(words, sizeof *memory), "memory");
    good(onescan_search_start(&search, model, bytes, rgb, width, height, landmarks, count, &settings,
                              memory, words));
    while (onescan_search_step(&search, 10) > 0) {
    }
    OnescanSearchProgress found;
    good(onescan_search_progress(&search, &found));
    printf("search %016llx\n", (unsigned long long)found.fingerprint);
    free(memory);
    free(rgb);
    free(model);
    return 0;
}
