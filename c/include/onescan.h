/* onescan: fit a 3D morphable model to a photo, in memory that the caller owns: by a search for the
 * mode of the posterior (onescan_search_...), or by the paper's Markov chain.
 * Written by cbindgen from c/src/lib.rs. A whole program: c/example.c. */

#ifndef ONESCAN_H
#define ONESCAN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/*
 The most landmarks a fit takes.
 */
#define ONESCAN_MAX_LANDMARKS 64

/*
 The most coefficients of a kind a fit infers.
 */
#define ONESCAN_MAX_RANK 200

/*
 Numbers in an OnescanFit, eight bytes each.
 */
#define ONESCAN_FIT_LENGTH 3072

/*
 Numbers in an OnescanSearch, eight bytes each.
 */
#define ONESCAN_SEARCH_LENGTH 1536

/*
 What became of a call.
 */
typedef enum {
  /*
   It did what it says.
   */
  ONESCAN_STATUS_OK = 0,
  /*
   A pointer is null that must not be.
   */
  ONESCAN_STATUS_NULL,
  /*
   The model's bytes do not start at a multiple of four.
   */
  ONESCAN_STATUS_MODEL_MISALIGNED,
  /*
   The bytes are not a model.
   */
  ONESCAN_STATUS_NOT_A_MODEL,
  /*
   The model has another format version.
   */
  ONESCAN_STATUS_MODEL_VERSION,
  /*
   The model's bytes are fewer or more than its header says.
   */
  ONESCAN_STATUS_MODEL_LENGTH,
  /*
   The model's bytes are damaged.
   */
  ONESCAN_STATUS_MODEL_DAMAGED,
  /*
   The picture is empty.
   */
  ONESCAN_STATUS_IMAGE,
  /*
   No landmarks, or more than ONESCAN_MAX_LANDMARKS.
   */
  ONESCAN_STATUS_LANDMARK_COUNT,
  /*
   A landmark that the model does not have, or a name that is not UTF-8.
   */
  ONESCAN_STATUS_UNKNOWN_LANDMARK,
  /*
   A landmark position that is not finite.
   */
  ONESCAN_STATUS_LANDMARK_POSITION,
  /*
   More coefficients than a fit infers.
   */
  ONESCAN_STATUS_RANK,
  /*
   A standard deviation that is not positive.
   */
  ONESCAN_STATUS_CONFIG,
  /*
   Too little memory.
   */
  ONESCAN_STATUS_MEMORY,
  /*
   A pointer to something that does not lie at a multiple of its alignment.
   */
  ONESCAN_STATUS_MISALIGNED,
  /*
   The fit was never started, or its last start failed.
   */
  ONESCAN_STATUS_NOT_STARTED,
  /*
   More of something than memory can hold.
   */
  ONESCAN_STATUS_COUNT,
} OnescanStatus;

/*
 How a fit is done. Begin with onescan_default_settings().
 */
typedef struct {
  /*
   Seed of all randomness.
   */
  uint64_t seed;
  /*
   Shape coefficients to infer, at most 200.
   */
  uint32_t shape_rank;
  /*
   Albedo coefficients to infer, at most 200.
   */
  uint32_t albedo_rank;
  /*
   Steps of the chain's landmark phase.
   */
  uint32_t landmark_samples;
  /*
   Steps of the shape phase: 0 for faces, 5000 for other objects.
   */
  uint32_t shape_samples;
  /*
   Steps of the image phase.
   */
  uint32_t samples;
  /*
   Standard deviation of a landmark, pixels; the default is for pictures of about 256.
   */
  float landmark_sd;
  /*
   Standard deviation of a pixel's colour channel, of 1.
   */
  float pixel_sd;
  /*
   Pixels that share one independent error; the default is for pictures of about 256, elsewhere it
   grows as the picture's area.
   */
  float pixel_patch;
  /*
   Whether (0: no) the chain also solves for the light in closed form; otherwise it samples its
   posterior.
   */
  uint8_t search;
  /*
   Whether memory is scarcer than time: the chain then takes less than half of it, same result.
   */
  uint8_t lean;
  /*
   Whether something may hide the face, for a search for the mode.
   */
  uint8_t occlusion;
} OnescanSettings;

/*
 What a model holds.
 */
typedef struct {
  /*
   Vertices.
   */
  uint32_t vertices;
  /*
   Triangles.
   */
  uint32_t triangles;
  /*
   Components of the shape.
   */
  uint32_t shape_rank;
  /*
   Components of the albedo.
   */
  uint32_t albedo_rank;
  /*
   Landmarks.
   */
  uint32_t landmarks;
} OnescanModelInfo;

/*
 A chain. Allocate it anywhere and do not move it between calls. If it is zero, as static memory
 is, or its last start failed, it counts as never started: calls say so.
 */
typedef struct {
  /*
   The library's.
   */
  uint64_t storage[ONESCAN_FIT_LENGTH];
} OnescanFit;

/*
 A landmark in the picture.
 */
typedef struct {
  /*
   Its name in the model.
   */
  const char *name;
  /*
   Pixels to the right of the centre of the upper left pixel.
   */
  float x;
  /*
   Pixels below it.
   */
  float y;
} OnescanLandmark;

/*
 A search for the mode. Allocate it anywhere and do not move it between calls. What is said of a chain
 that was never started holds here, too.
 */
typedef struct {
  /*
   The library's.
   */
  uint64_t storage[ONESCAN_SEARCH_LENGTH];
} OnescanSearch;

/*
 How far a chain is, and how good.
 */
typedef struct {
  /*
   Steps done.
   */
  uint32_t done;
  /*
   Steps in all.
   */
  uint32_t total;
  /*
   Hash of every accepted state: equal on every machine.
   */
  uint64_t fingerprint;
  /*
   Log posterior density of the best state, up to a constant.
   */
  double best;
} OnescanProgress;

/*
 How far a search for the mode is, and how good.
 */
typedef struct {
  /*
   Steps done.
   */
  uint32_t done;
  /*
   The most steps it may make.
   */
  uint32_t most;
  /*
   Whether it has ended.
   */
  bool ended;
  /*
   Whether its last steps changed nothing.
   */
  bool converged;
  /*
   Hash of every scene on the way: equal on every machine.
   */
  uint64_t fingerprint;
  /*
   Negative log posterior density, up to a constant that differs from level to level.
   */
  double energy;
} OnescanSearchProgress;

/*
 What was found: everything the picture depends on.
 */
typedef struct {
  /*
   Turn about the axis of view, radians; the last of the three turns.
   */
  float roll;
  /*
   Turn to the side, radians.
   */
  float yaw;
  /*
   Turn up or down, radians; the first.
   */
  float pitch;
  /*
   Factor of the model's size.
   */
  float scale;
  /*
   Where the model's origin is, mm: x to the right, y up, z towards the camera's back.
   */
  float translation[3];
  /*
   Focal length, in the sensor's unit.
   */
  float focal_length;
  /*
   Width and height of the sensor.
   */
  float sensor[2];
  /*
   Where the optical axis meets the picture: -1 to 1 to the right and up.
   */
  float principal_point[2];
  /*
   Spherical harmonics of the light: nine, red, green and blue.
   */
  float light[9][3];
  /*
   Factors of red, green and blue.
   */
  float gain[3];
  /*
   Contrast of colours to grey.
   */
  float contrast;
  /*
   Added to red, green and blue.
   */
  float offset[3];
  /*
   Shape coefficients that were inferred.
   */
  uint32_t shape_rank;
  /*
   Albedo coefficients that were inferred.
   */
  uint32_t albedo_rank;
  /*
   They, in standard deviations; 0 beyond.
   */
  float shape[ONESCAN_MAX_RANK];
  /*
   They, in standard deviations; 0 beyond.
   */
  float albedo[ONESCAN_MAX_RANK];
} OnescanScene;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 What a status means, in English; a number that is no status has a text, too.
 */
const char *onescan_status_text(uint32_t status);

/*
 The settings of the paper's face fit.
 */
OnescanSettings onescan_default_settings(void);

/*
 Checks a model's bytes, which must start at a multiple of four.

 # Safety
 `model` points to `bytes` bytes or is null; `info` to a OnescanModelInfo or is null.
 */
OnescanStatus onescan_model_info(const uint8_t *model, size_t bytes, OnescanModelInfo *info);

/*
 Words (4 bytes) of memory of a chain. 0 if a pointer is null, or if that is more than there can be.

 # Safety
 `info` and `settings` point to what they say or are null.
 */
size_t onescan_words(const OnescanModelInfo *info,
                     const OnescanSettings *settings,
                     size_t landmarks,
                     uint32_t width,
                     uint32_t height);

/*
 Words (4 bytes) of memory of a search for the mode. 0 as of onescan_words().

 # Safety
 `info` and `settings` point to what they say or are null.
 */
size_t onescan_search_words(const OnescanModelInfo *info,
                            const OnescanSettings *settings,
                            size_t landmarks,
                            uint32_t width,
                            uint32_t height);

/*
 Starts a chain. `rgb` are `3 * width * height` bytes, rows from the top. Nothing is copied:
 model, picture, landmark names and memory must stay as long as the fit is used.

 # Safety
 Pointers point to as many things as the numbers beside them say, or are null.
 */
OnescanStatus onescan_start(OnescanFit *fit,
                            const uint8_t *model,
                            size_t model_bytes,
                            const uint8_t *rgb,
                            uint32_t width,
                            uint32_t height,
                            const OnescanLandmark *landmarks,
                            size_t landmark_count,
                            const OnescanSettings *settings,
                            uint32_t *memory,
                            size_t memory_words);

/*
 Starts a search for the mode: pose, camera, shape, albedo, light, colours and what hides the
 face, by pixels and landmarks. Takes what onescan_start takes; of the settings those of a chain
 alone are of no consequence.

 # Safety
 Pointers point to as many things as the numbers beside them say, or are null.
 */
OnescanStatus onescan_search_start(OnescanSearch *search,
                                   const uint8_t *model,
                                   size_t model_bytes,
                                   const uint8_t *rgb,
                                   uint32_t width,
                                   uint32_t height,
                                   const OnescanLandmark *landmarks,
                                   size_t landmark_count,
                                   const OnescanSettings *settings,
                                   uint32_t *memory,
                                   size_t memory_words);

/*
 Makes up to `steps` steps; how many it made. 0: the chain is done.

 # Safety
 `fit` is null, zero or was started.
 */
uint32_t onescan_step(OnescanFit *fit, uint32_t steps);

/*
 Makes up to `steps` steps of a search; how many it made. 0: it is done. A step takes as long as
 some dozens of renderings.

 # Safety
 `search` is null, zero or was started.
 */
uint32_t onescan_search_step(OnescanSearch *search, uint32_t steps);

/*
 How far a chain is.

 # Safety
 `fit` is null, zero or was started; `progress` points to a OnescanProgress or is null.
 */
OnescanStatus onescan_progress(OnescanFit *fit, OnescanProgress *progress);

/*
 How far a search is.

 # Safety
 `search` is null, zero or was started; `progress` points to a
 OnescanSearchProgress or is null.
 */
OnescanStatus onescan_search_progress(OnescanSearch *search, OnescanSearchProgress *progress);

/*
 What a search has found so far.

 # Safety
 `search` is null, zero or was started; `scene` points to a OnescanScene or is
 null.
 */
OnescanStatus onescan_search_scene(OnescanSearch *search, OnescanScene *scene);

/*
 The mask of a search so far, `width * height` numbers, rows from the top: the probability of a
 pixel to show the face, 0 where the face does not reach. It is good until the next call with the
 search. Null if the search is.

 # Safety
 `search` is null, zero or was started.
 */
const float *onescan_search_mask(OnescanSearch *search);

/*
 Draws the best state so far over a picture of the fit's size, `3 * width * height` numbers of
 0 to 1; what the model does not cover stays. `memory` is other memory than the fit's, as large
 as that of a lean fit.

 # Safety
 As the pointers of onescan_start.
 */
OnescanStatus onescan_draw(OnescanFit *fit, float *colors, uint32_t *memory, size_t memory_words);

/*
 Draws what a search has found so far, as onescan_draw does.

 # Safety
 As the pointers of onescan_search_start.
 */
OnescanStatus onescan_search_draw(OnescanSearch *search,
                                  float *colors,
                                  uint32_t *memory,
                                  size_t memory_words);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* ONESCAN_H */

/* Words of memory of a search, for static arrays: what onescan_search_words() says of these sizes.
 * `lean` is 0 or 1. */
#define ONESCAN_SEARCH_WORDS(vertices, triangles, shape_rank, albedo_rank, landmarks, width, height, lean) \
  (9 * ONESCAN_PIXELS(width, height) + 65 * ONESCAN_CHUNKS(width, height) +                         \
   17 * ONESCAN_PADDED(vertices) + 1 + ((size_t)(vertices) + 3) / 4 + 3 * (size_t)(triangles) +     \
   ((lean) ? 0 : 24 * (size_t)(vertices) * (ONESCAN_GROUPS(shape_rank) + ONESCAN_GROUPS(albedo_rank))) + \
   3 * (landmarks) * (1 + (shape_rank)) +                                                            \
   5 * ONESCAN_UNKNOWNS(shape_rank, albedo_rank) +                                                  \
   ONESCAN_MAX(ONESCAN_MAX(15625, 12 * ONESCAN_PADDED(vertices)),                                   \
               ONESCAN_SYSTEM(ONESCAN_UNKNOWNS(shape_rank, albedo_rank)) +                          \
                   ONESCAN_MAX(ONESCAN_MATRIX(ONESCAN_UNKNOWNS(shape_rank, albedo_rank)),           \
                               3 * ONESCAN_PIXELS(width, height))))
#define ONESCAN_PIXELS(width, height) ((size_t)(width) * (height))
#define ONESCAN_UNKNOWNS(shape_rank, albedo_rank) ((size_t)(shape_rank) + (albedo_rank) + 41)
#define ONESCAN_MATRIX(n) ((n) * 16 * ONESCAN_GROUPS(n))
#define ONESCAN_GROUPS(n) (((size_t)(n) + 15) / 16)

/* Words of memory of a chain, for static arrays: what onescan_words() says of these sizes. `lean` is
 * 0 or 1. */
#define ONESCAN_WORDS(vertices, shape_rank, albedo_rank, landmarks, width, height, lean)           \
  (28 * ONESCAN_CHUNKS(width, height) +                                                            \
   ONESCAN_MAX(15625,                                                                              \
               ((lean) ? 1 : 2) * (12 * ONESCAN_PADDED(vertices) + 65 * ONESCAN_CHUNKS(width, height)) + \
                   4 * ONESCAN_PADDED(vertices) +                                                  \
                   ((lean) ? 0 : 96) * ONESCAN_CHUNKS(width, height) +                             \
                   3 * (landmarks) * (1 + (shape_rank))))
#define ONESCAN_MAX(a, b) ((a) > (b) ? (a) : (b))
#define ONESCAN_CHUNKS(width, height) (((size_t)(width) + 15) / 16 * (height))
#define ONESCAN_PADDED(vertices) (((size_t)(vertices) + 31) / 32 * 32)
#define ONESCAN_SYSTEM(n) (((size_t)(n) + ONESCAN_BATCH(n)) * 16 * ONESCAN_GROUPS(n) + 2 * (n))
#define ONESCAN_BATCH(n) ((n) < 128 ? 8 : (n) < 512 ? (size_t)(n) / 64 * 8 : 64)
