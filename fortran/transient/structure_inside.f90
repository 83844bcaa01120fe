!> The motion of a structure inside a step, exact like its maps at the end of the step.
module viscovib_structure_inside
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_constants, only: imaginary_unit
  use viscovib_kinds, only: wp
  use viscovib_modal_maps, only: legendre_of_nodes, sections_type
  use viscovib_phases, only: split_phase
  use viscovib_pole_maps, only: poles_inside, rates_at_once
  use viscovib_section_step, only: driven_section, free_section, section_wave
  use viscovib_structure_step, only: part_type
  implicit none
  private

  public :: state_inside

contains

  !> Modes and their velocities at the time `ahead` after the start of a part.
  subroutine state_inside(part, sections, usual, ahead, q, v, z, z_rate)
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    !> Table of ordinary steps; parts of a first step have their own table.
    type(collocation_type), intent(in) :: usual
    real(wp), intent(in) :: ahead
    !> Shape (n).
    real(wp), intent(out) :: q(:), v(:)
    complex(wp), intent(out) :: z(:)
    !> Rates of the massless variables.
    real(wp), intent(inout) :: z_rate(:)
    type(collocation_type) :: table
    real(wp) :: orders(part%s, size(sections%pushed, 2)), push(part%s)
    real(wp) :: by_order(part%s), rates(part%s), by_q(2), by_v(2)
    real(wp) :: high(size(sections%frequencies)), low(size(sections%frequencies))
    complex(wp) :: answer, velocity, wave
    integer :: k, m

    q = part%q
    v = part%v
    z = part%z
    if (.not. ahead > 0.0_wp) return
    if (part%s == usual%s) then
      table = usual
    else
      call new_collocation(table, part%s)
    end if
    orders = matmul(legendre_of_nodes(table, ahead/part%length), part%forces)
    call split_phase(sections%frequencies, part%start, high, low)
    do m = 1, size(q)
      associate (square => sections%squares(m)*ahead**2, rate => sections%rates(m)*ahead)
        call free_section(square, rate, by_q, by_v)
        call driven_section(square, rate, by_order, rates)
        push = matmul(orders, sections%pushed(m, :))
        q(m) = part%q(m) + (by_q(1)*part%q(m) + ahead*by_v(1)*part%v(m)) &
               + ahead**2*dot_product(by_order, push)
        v(m) = part%v(m) + (by_q(2)/ahead*part%q(m) + by_v(2)*part%v(m)) &
               + ahead*dot_product(rates, push)
        do k = 1, size(high)
          if (.not. abs(sections%waves(m, k)) > 0.0_wp) cycle
          call section_wave(square, rate, sections%frequencies(k)*ahead, answer, velocity)
          wave = sections%waves(m, k)*exp(imaginary_unit*(high(k) + low(k)))
          q(m) = q(m) + ahead**2*aimag(wave*answer)
          v(m) = v(m) + ahead*aimag(wave*velocity)
        end do
      end associate
    end do
    call poles_inside(sections%others, sections%frequencies, ahead, orders, high + low, z)
    if (size(z_rate) == 0) return
    call rates_at_once(sections%others, table, sections%frequencies, ahead/part%length, &
                       part%length, part%forces, high + low + sections%frequencies*ahead, z_rate)
  end subroutine state_inside

end module viscovib_structure_inside
