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
    settings = onescan_default_settings();
    settings.shape_rank = 201;
    expect("a high rank", START(&nose, 1, 16, words), ONESCAN_STATUS_RANK);
    if (strcmp(onescan_status_text(12345), "not a status of this library") != 0) {
        faults++;
    }
    return faults > 0;
}
