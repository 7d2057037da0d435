/* A handler is a function that the board calls. */
#ifndef HOST_INTERRUPT_H
#define HOST_INTERRUPT_H
#define ISR(vector) \
    void vector(void); \
    void vector(void)
#endif
