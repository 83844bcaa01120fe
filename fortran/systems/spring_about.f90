!> Spring forces of a body's mounts, and the same springs about a given deflection.
module viscovib_spring_about
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: add, put_argument, put_number, subtract
  use viscovib_law_term, only: about_rest, law_term
  use viscovib_polynomial, only: max_degree
  use viscovib_turning_body, only: body_spring
  implicit none
  private

  public :: force_of, spring_about, spring_at

contains

  !> Force k d + g(d) without memory, and its slope.
  subroutine force_of(spring, d, force, slope)
    type(body_spring), intent(in) :: spring
    real(wp), intent(in) :: d
    real(wp), intent(out) :: force, slope
    real(wp) :: value(1), by(1, 2)
    integer :: i, power

    force = spring%stiffness*d
    slope = spring%stiffness
    do power = 2, size(spring%coefficient) + 1
      associate (c => spring%coefficient(power - 1))
        force = force + c*d**power
        slope = slope + power*c*d**(power - 1)
      end associate
    end do
    do i = 1, size(spring%laws)
      call spring%laws(i)%program%differentiate(reshape([d, 0.0_wp], [1, 2]), value, by)
      force = force + value(1)
      slope = slope + by(1, 1)
    end do
  end subroutine force_of

  !> The spring about a deflection: its force increment, with laws of d and its rate.
  function spring_at(spring, at) result(seen)
    type(body_spring), intent(in) :: spring
    real(wp), intent(in) :: at
    type(body_spring) :: seen
    real(wp) :: ways, series(2:max_degree)
    integer :: i, p, power

    seen = spring
    series = 0.0_wp
    do power = 2, size(spring%coefficient) + 1
      associate (c => spring%coefficient(power - 1))
        ways = power
        seen%stiffness = seen%stiffness + ways*c*at**(power - 1)
        do p = 2, power
          ways = ways*(power - p + 1)/p
          series(p) = series(p) + ways*c*at**(power - p)
        end do
      end associate
    end do
    seen%coefficient = series(:size(spring%coefficient) + 1)
    do i = 1, size(seen%laws)
      call shift(seen%laws(i), at)
    end do
  end function spring_at

  !> The same, with each law split into its linear part, in the stiffness and the damping, and its
  !! remainder.
  function spring_about(spring, at) result(seen)
    type(body_spring), intent(in) :: spring
    real(wp), intent(in) :: at
    type(body_spring) :: seen
    real(wp) :: slopes(2)
    character(len=:), allocatable :: fault
    integer :: i

    seen = spring_at(spring, at)
    do i = 1, size(seen%laws)
      associate (law => seen%laws(i))
        law%kernel = spring%kernel
        call about_rest(law, slopes, fault)
        law%arguments = reshape([1.0_wp, 0.0_wp], [2, 1])
        law%rates = reshape([0.0_wp, 1.0_wp], [2, 1])
        seen%stiffness = seen%stiffness + slopes(1)
        seen%damping = seen%damping + slopes(2)
      end associate
    end do
  end function spring_about

  !> Replace f(d) by f(at + d) - f(at).
  subroutine shift(law, at)
    type(law_term), intent(inout) :: law
    real(wp), intent(in) :: at
    integer, allocatable :: code(:)
    real(wp), allocatable :: number(:)
    real(wp) :: value(1), by(1, 2)
    integer :: i

    if (.not. abs(at) > 0.0_wp) return
    call law%program%differentiate(reshape([at, 0.0_wp], [1, 2]), value, by)
    allocate (code(0), number(0))
    do i = 1, size(law%program%code)
      code = [code, law%program%code(i)]
      number = [number, law%program%number(i)]
      if (law%program%code(i) /= put_argument .or. nint(law%program%number(i)) /= 1) cycle
      code = [code, put_number, add]
      number = [number, at, 0.0_wp]
    end do
    law%program%code = [code, put_number, subtract]
    law%program%number = [number, value(1), 0.0_wp]
    call law%program%measure()
    law%parity = 0
  end subroutine shift

end module viscovib_spring_about
