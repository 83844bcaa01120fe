!> Massless variables at the start of a motion or after a jump of the load: a step so short that
!! everything else is constant determines the forces, and their polynomials give values and slopes
!! at its start.
module viscovib_structure_settle
  use viscovib_collocation, only: collocation_type
  use viscovib_hereditary_maps, only: remaining_weights
  use viscovib_kinds, only: wp
  use viscovib_memory_channels, only: channels_type
  use viscovib_modal_maps, only: sections_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_phases, only: split_phase
  use viscovib_pole_maps, only: rates_at_once
  use viscovib_quadrature, only: lagrange, lagrange_factors
  use viscovib_structure_state, only: start_state, state_type
  use viscovib_structure_step, only: structure_panels
  use viscovib_time_load, only: time_load_type
  implicit none
  private

  public :: settle_at_once

  !> Length of that step, relative to the steps of the run.
  real(wp), parameter :: short = 1.0e-3_wp

contains

  !> `recalled`: memory at the nodes of the next step.
  subroutine settle_at_once(state, system, sections, channels, table, load, now, h, solved, &
                            recalled, made)
    type(state_type), intent(inout) :: state
    class(oscillator_type), intent(in) :: system
    type(sections_type), intent(in), target :: sections
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: now, h, solved, recalled(:)
    logical, intent(out) :: made
    type(structure_panels) :: panels
    real(wp) :: local(table%s, 0:table%s + 1, size(system%kernels))
    real(wp) :: points(0:table%s + 1, size(system%gather, 2))
    real(wp) :: g(0:table%s + 1, size(channels%kernel_of))
    real(wp) :: high(size(sections%frequencies)), low(size(sections%frequencies))
    real(wp) :: e(table%s, 0:table%s + 1, 0:size(system%kernels))
    real(wp) :: early(table%s, table%s), weights(table%s), factors(table%s)
    real(wp) :: forces(size(sections%pushed, 2))
    integer :: i, m

    associate (c => table%points(1:table%s))
      factors = lagrange_factors(c)
      weights = lagrange(c, factors, 0.0_wp)
      do i = 1, table%s
        early(i, :) = lagrange(c, factors, short*c(i))
      end do
    end associate
    call remaining_weights(system, table, short*h, e)
    local = -e(:, :, 1:)
    do i = 1, table%s
      local(i, i, :) = local(i, i, :) + 1.0_wp
    end do
    panels%sections => sections
    panels%state = state
    panels%solved = solved
    allocate (panels%parts(1))
    call panels%make(system, channels, load, table, local, now, short*h, &
                     matmul(early, reshape(recalled, [table%s, size(g, 2)])), points, g, made)
    if (.not. made) return
    call split_phase(sections%frequencies, now, high, low)
    associate (part => panels%parts(1), poles => sections%others, phi => high + low)
      forces = matmul(weights, part%forces)
      do i = 1, poles%n_at_once
        m = size(poles%poles) - poles%n_at_once + i
        state%z(m) = sum(real(poles%right(m, :))*forces) &
                     + sum(real(poles%sine(m, :))*sin(phi) + real(poles%cosine(m, :))*cos(phi))
        state%z_rest(m) = (0.0_wp, 0.0_wp)
      end do
      call rates_at_once(poles, table, sections%frequencies, 0.0_wp, short*h, part%forces, phi, &
                         state%z_rate)
    end associate
    call start_state(state, sections)
  end subroutine settle_at_once

end module viscovib_structure_settle
