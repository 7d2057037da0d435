/* Interrupts wait for the end of the block; the board then serves them. */
#ifndef HOST_ATOMIC_H
#define HOST_ATOMIC_H
#define ATOMIC_RESTORESTATE 0
void board_serve_interrupts(void);
#define ATOMIC_BLOCK(kind) for (int once = 1; once; once = 0, board_serve_interrupts())
#endif
