/* Implementation of tags.h. */
#include "tags.h"

#define FLAG 0x7EU
#define ESCAPE 0x7DU
#define HEADER_BYTES 3U
#define CRC_BYTES 4U
#define TAG_BYTES 19U /* Header and fields of a tag telegram, before the payload. */
#define HEALTH_BYTES 20U
#define PAYLOAD_MAX 104U

static uint32_t number(const uint8_t *from, uint32_t bytes)
{
    uint32_t value = 0U;
    for (uint32_t at = 0U; at < bytes; at++) {
        value = (value << 8U) | from[at];
    }
    return value;
}

/* CRC-32 as in Ethernet, four bits a step. */
static uint32_t crc32_of(const uint8_t *data, uint32_t length)
{
    uint32_t crc = 0xFFFFFFFFU;
    for (uint32_t at = 0U; at < length; at++) {
        crc ^= data[at];
        for (uint32_t bit = 0U; bit < 8U; bit++) {
            crc = (crc >> 1U) ^ (((crc & 1U) != 0U) ? 0xEDB88320U : 0U);
        }
    }
    return ~crc;
}

static bool is_whole(const struct tags_parser *parser)
{
    const uint8_t *content = parser->content;
    const uint32_t body = parser->length - CRC_BYTES;
    bool whole = false;
    if ((parser->length >= HEADER_BYTES + CRC_BYTES) &&
        (crc32_of(content, body) == number(&content[body], CRC_BYTES)) && (content[0] == 1U)) {
        if (content[1] == 1U) {
            whole = (body >= TAG_BYTES) && (content[18] <= PAYLOAD_MAX) &&
                    (body == TAG_BYTES + content[18]) && (content[3] >= 1U) &&
                    (content[3] <= 5U) && (number(&content[4], 4U) != 0U);
        } else {
            whole = (content[1] == 2U) && (body == HEALTH_BYTES) && (content[3] <= 1U);
        }
    }
    return whole;
}

/* The flag ends a telegram. */
static bool finish(struct tags_parser *parser, struct tags_telegram *telegram)
{
    const uint8_t *content = parser->content;
    bool is_tag = false;
    if (parser->spoiled || parser->escaped || !is_whole(parser)) {
        parser->damaged++;
    } else if (parser->begun && (content[2] == parser->sequence)) {
        parser->repeated++;
    } else {
        parser->begun = true;
        parser->sequence = content[2];
        is_tag = content[1] == 1U;
        if (is_tag) {
            telegram->kind = (enum tags_kind)content[3];
            telegram->tag_id = number(&content[4], 4U);
            telegram->pulses = (uint16_t)number(&content[16], 2U);
        }
    }
    return is_tag;
}

bool tags_take(struct tags_parser *parser, uint8_t byte, struct tags_telegram *telegram)
{
    bool is_tag = false;
    if (byte == FLAG) {
        if (parser->open && ((parser->length > 0U) || parser->spoiled)) {
            is_tag = finish(parser, telegram);
        }
        parser->open = true;
        parser->length = 0U;
        parser->escaped = false;
        parser->spoiled = false;
    } else if (!parser->open || parser->spoiled) {
        /* Bytes before the first flag, or after damage. */
    } else if (parser->escaped) {
        parser->escaped = false;
        parser->spoiled = ((byte != 0x5EU) && (byte != 0x5DU)) ||
                          (parser->length >= TAGS_CONTENT_MAX);
        if (!parser->spoiled) {
            parser->content[parser->length] = (uint8_t)(byte ^ 0x20U);
            parser->length++;
        }
    } else if (byte == ESCAPE) {
        parser->escaped = true;
    } else {
        parser->spoiled = parser->length >= TAGS_CONTENT_MAX;
        if (!parser->spoiled) {
            parser->content[parser->length] = byte;
            parser->length++;
        }
    }
    return is_tag;
}
