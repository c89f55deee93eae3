/* What the library says of bad input: errors MODEL.3dmm */
#include "onescan.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static uint32_t model[512 * 1024 / 4];
static uint32_t damaged[512 * 1024 / 4];
static uint8_t rgb[3 * 16 * 16];
static uint32_t memory[100000];
static OnescanFit fit;
static OnescanSearch search;
static int faults;

static void expect(const char *what, OnescanStatus found, OnescanStatus expected)
{
    if (found != expected) {
        fprintf(stderr, "%s: %s, not %s\n", what, onescan_status_text(found),
                onescan_status_text(expected));
        faults++;
    }
}

int main(int argc, char **argv)
{
    FILE *file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    if (file == NULL) {
        fprintf(stderr, "usage: errors MODEL.3dmm\n");
        return 2;
    }
    size_t bytes = fread(model, 1, sizeof model, file);
    fclose(file);
    const uint8_t *start = (const uint8_t *)model;
    OnescanModelInfo info;
    expect("the model", onescan_model_info(start, bytes, &info), ONESCAN_STATUS_OK);
    expect("no model", onescan_model_info(NULL, bytes, &info), ONESCAN_STATUS_NULL);
    expect("no info", onescan_model_info(start, bytes, NULL), ONESCAN_STATUS_NULL);
    expect("moved", onescan_model_info(start + 1, bytes - 1, &info),
           ONESCAN_STATUS_MODEL_MISALIGNED);
    expect("cut", onescan_model_info(start, bytes - 4, &info), ONESCAN_STATUS_MODEL_LENGTH);
    expect("nothing", onescan_model_info(start, 0, &info), ONESCAN_STATUS_NOT_A_MODEL);
    memcpy(damaged, model, bytes);
    damaged[bytes / 8] ^= 1;
    expect("damaged", onescan_model_info((uint8_t *)damaged, bytes, &info),
           ONESCAN_STATUS_MODEL_DAMAGED);
    damaged[2] = 99;
    expect("another version", onescan_model_info((uint8_t *)damaged, bytes, &info),
           ONESCAN_STATUS_MODEL_VERSION);

    OnescanSettings settings = onescan_default_settings();
    OnescanProgress progress;
    OnescanSearchProgress none;
    expect("a fit never started", onescan_progress(&fit, &progress), ONESCAN_STATUS_NOT_STARTED);
    expect("a search never started", onescan_search_progress(&search, &none),
           ONESCAN_STATUS_NOT_STARTED);
    if (onescan_step(&fit, 1) != 0 || onescan_search_step(&search, 1) != 0 ||
        onescan_search_mask(&search) != NULL) {
        fprintf(stderr, "a fit never started does something\n");
        faults++;
    }
    settings.lean = true;
    settings.landmark_samples = settings.samples = 10;
    OnescanLandmark nose = {"center.nose.tip", 8, 8};
    size_t words = sizeof memory / sizeof *memory;
#define START(landmark, count, side, room)                                                         \
    onescan_start(&fit, start, bytes, rgb, side, side, landmark, count, &settings, memory, room)
    expect("a fit", START(&nose, 1, 16, words), ONESCAN_STATUS_OK);
    if (onescan_step(&fit, 1000) != 20 || onescan_step(&fit, 1) != 0) {
        fprintf(stderr, "a fit of 10 + 10 steps has another number\n");
        faults++;
    }
    float colors[3 * 16 * 16] = {0};
    static uint32_t more[100000];
    expect("a picture", onescan_draw(&fit, colors, more, words), ONESCAN_STATUS_OK);
    expect("a picture in no room", onescan_draw(&fit, colors, more, 9), ONESCAN_STATUS_MEMORY);
    expect("a restart that fails", START(&nose, 0, 16, words), ONESCAN_STATUS_LANDMARK_COUNT);
    expect("its progress", onescan_progress(&fit, &progress), ONESCAN_STATUS_NOT_STARTED);
    expect("its picture", onescan_draw(&fit, colors, more, words), ONESCAN_STATUS_NOT_STARTED);
    if (onescan_step(&fit, 1) != 0) {
        fprintf(stderr, "a fit whose start failed does something\n");
        faults++;
    }
    expect("endless landmarks", START(&nose, SIZE_MAX / 2, 16, words), ONESCAN_STATUS_COUNT);
    expect("endless memory", START(&nose, 1, 16, SIZE_MAX), ONESCAN_STATUS_COUNT);
    uint32_t *odd = (uint32_t *)((char *)memory + 1);
    expect("odd memory", onescan_start(&fit, start, bytes, rgb, 16, 16, &nose, 1, &settings, odd, 9),
           ONESCAN_STATUS_MISALIGNED);
    expect("an odd fit", onescan_progress((OnescanFit *)((char *)&fit + 4), &progress),
           ONESCAN_STATUS_MISALIGNED);
    if (onescan_words(&info, &settings, 1, UINT32_MAX, UINT32_MAX) != 0) {
        fprintf(stderr, "an endless picture has a number of words\n");
        faults++;
    }
    settings.lean = 2;
    expect("a truth of 2", START(&nose, 1, 16, words), ONESCAN_STATUS_OK);
    settings.lean = true;
    expect("no landmarks", START(&nose, 0, 16, words), ONESCAN_STATUS_LANDMARK_COUNT);
    expect("no picture", START(&nose, 1, 0, words), ONESCAN_STATUS_IMAGE);
    size_t needed = onescan_words(&info, &settings, 1, 16, 16);
    expect("little memory", START(&nose, 1, 16, needed - 1), ONESCAN_STATUS_MEMORY);
    expect("enough memory", START(&nose, 1, 16, needed), ONESCAN_STATUS_OK);
    OnescanLandmark tail = {"tail", 8, 8}, nowhere = {"center.nose.tip", NAN, 8}, unnamed = {0};
    expect("a tail", START(&tail, 1, 16, words), ONESCAN_STATUS_UNKNOWN_LANDMARK);
    expect("nowhere", START(&nowhere, 1, 16, words), ONESCAN_STATUS_LANDMARK_POSITION);
    expect("unnamed", START(&unnamed, 1, 16, words), ONESCAN_STATUS_NULL);
    settings.pixel_sd = 0;
    expect("no deviation", START(&nose, 1, 16, words), ONESCAN_STATUS_CONFIG);
    settings.pixel_sd = 0.1f;

#define SEARCH(landmark, count, side, room)                                                        \
    onescan_search_start(&search, start, bytes, rgb, side, side, landmark, count, &settings, memory, room)
    needed = onescan_search_words(&info, &settings, 1, 16, 16);
    expect("a search in little memory", SEARCH(&nose, 1, 16, needed - 1), ONESCAN_STATUS_MEMORY);
    expect("a search", SEARCH(&nose, 1, 16, needed), ONESCAN_STATUS_OK);
    OnescanSearchProgress found;
    expect("its progress", onescan_search_progress(&search, &found), ONESCAN_STATUS_OK);
    unsigned made = 0;
    for (unsigned last = 1; last > 0; made += last)
        last = onescan_search_step(&search, 3);
    expect("its end", onescan_search_progress(&search, &found), ONESCAN_STATUS_OK);
    if (found.done != made || found.done > found.most || made == 0 || !found.ended) {
        fprintf(stderr, "a search of %u steps says %u of %u\n", made, found.done, found.most);
        faults++;
    }
    static OnescanScene scene;
    expect("its scene", onescan_search_scene(&search, &scene), ONESCAN_STATUS_OK);
    if (scene.shape_rank != info.shape_rank || scene.albedo_rank != info.albedo_rank ||
        !(scene.translation[2] < 0) || scene.shape[info.shape_rank] != 0) {
        fprintf(stderr, "the scene has %u + %u coefficients\n", scene.shape_rank, scene.albedo_rank);
        faults++;
    }
    const float *mask = onescan_search_mask(&search);
    for (int i = 0; i < 16 * 16; i++)
        faults += !(mask[i] >= 0 && mask[i] <= 1);
    expect("its picture", onescan_search_draw(&search, colors, more, words), ONESCAN_STATUS_OK);
    expect("its picture in no room", onescan_search_draw(&search, colors, more, 9),
           ONESCAN_STATUS_MEMORY);
    expect("a search for a tail", SEARCH(&tail, 1, 16, needed), ONESCAN_STATUS_UNKNOWN_LANDMARK);
    expect("a search in nothing", SEARCH(&nose, 1, 0, needed), ONESCAN_STATUS_IMAGE);
    expect("no search", onescan_search_progress(NULL, &found), ONESCAN_STATUS_NULL);
    expect("no scene", onescan_search_scene(NULL, &scene), ONESCAN_STATUS_NULL);
    if (onescan_search_mask(NULL) != NULL || onescan_search_step(NULL, 1) != 0 ||
        onescan_search_words(NULL, &settings, 1, 16, 16) != 0) {
        fprintf(stderr, "no search does something\n");
        faults++;
    }
    settings = onescan_default_settings();
    settings.shape_rank = 201;
    expect("a high rank", START(&nose, 1, 16, words), ONESCAN_STATUS_RANK);
    if (strcmp(onescan_status_text(12345), "not a status of this library") != 0) {
        faults++;
    }
    return faults > 0;
}
