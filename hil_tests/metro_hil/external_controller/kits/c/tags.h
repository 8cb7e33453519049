/* Telegrams of the tag reader: docs/reference/serial_interface.md of the bench. */
#ifndef TAGS_H
#define TAGS_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TAGS_CONTENT_MAX 128U

enum tags_kind { TAGS_BALISE = 1, TAGS_T1 = 2, TAGS_T2 = 3, TAGS_T3 = 4, TAGS_STOP = 5 };

struct tags_telegram {
    enum tags_kind kind;
    uint32_t tag_id;
    uint16_t pulses; /* Counter of tacho A when the antenna was over the tag. */
};

/* A parser starts as zeros. */
struct tags_parser {
    uint8_t content[TAGS_CONTENT_MAX];
    uint32_t length;
    bool open;     /* A flag was received. */
    bool escaped;
    bool spoiled;  /* Skip everything up to the next flag. */
    bool begun;
    uint8_t sequence;  /* Of the last telegram. */
    uint32_t damaged;  /* Telegrams that were refused. */
    uint32_t repeated; /* Telegrams with the sequence of the one before. */
};

/* Take one byte. Return true when it completes a tag telegram; health telegrams are skipped. */
bool tags_take(struct tags_parser *parser, uint8_t byte, struct tags_telegram *telegram);

#ifdef __cplusplus
}
#endif

#endif
