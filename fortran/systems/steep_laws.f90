!> Force laws whose slope by a rate is infinite where the rate is 0, such as c sign(v) |v|^a with
!! 0 < a < 1 of a fluid viscous damper.
!!
!! Newton's method in v does not converge near v = 0 for a < 1/2. In the variable
!!
!!   w = sign(v) |v|^a,   v = sign(w) |w|^(1/a),
!!
!! the force and the rate are both smooth, monotonic functions, so that Newton's method converges
!! from any start. The force of the damper itself is c w.
module viscovib_steep_laws
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: find_signals
  use viscovib_law_program, only: add, divide, law_program, multiply, put_argument, put_number, wall
  use viscovib_law_roots, only: find_roots
  use viscovib_law_term, only: law_term
  implicit none
  private

  public :: steep_law, find_steep, join_arguments, rate_of_root, root_of_rate, steep_force

  !> A steep law: its index, the argument that is the rate (a velocity, maybe with a part of a
  !! displacement, as of a spring in series), and the exponent a; the steep law with a
  !! proportional rate and the smallest exponent, maybe itself, and the factor to its rate.
  type :: steep_law
    integer :: law = 0, argument = 0
    real(wp) :: exponent = 1.0_wp
    integer :: leader = 0
    real(wp) :: factor = 1.0_wp
  end type steep_law

  !> Rates at which the exponent is checked, and the relative error of the ratio of forces there.
  real(wp), parameter :: near = 1.0e-10_wp, nearer = 1.0e-14_wp, alike = 0.5_wp, &
                         odd = 1.0e-3_wp
  !> Rate below which the force is linear in w to rounding, and its slopes may be too large.
  real(wp), parameter :: least = 1.0e-50_wp

contains

  !> The steep laws among laws without internal state.
  subroutine find_steep(laws, found)
    type(law_term), intent(in) :: laws(:)
    type(steep_law), allocatable, intent(out) :: found(:)
    type(law_program), allocatable :: signals(:)
    type(steep_law) :: one
    integer :: i, j, k
    integer :: none(0)

    allocate (found(0))
    do i = 1, size(laws)
      if (laws(i)%state > 0 .or. laws(i)%program%n_surfaces() == 0) cycle
      associate (program => laws(i)%program)
        block
          logical :: roots(size(program%code))
          real(wp) :: rough(program%n_surfaces())
          call find_roots(program%code, program%number, roots, rough)
          call find_signals(program, none, signals)
          one = steep_law()
          do j = 1, size(rough)
            if (.not. (rough(j) > 0.0_wp .and. rough(j) < 1.0_wp)) cycle
            ! A second root, or one of a function of several arguments, is treated as other laws.
            if (one%law > 0 .or. .not. is_multiple(signals(j))) exit
            k = findloc(signals(j)%code, put_argument, 1)
            one = steep_law(i, nint(signals(j)%number(k)), rough(j))
          end do
          if (j > size(rough) .and. one%law > 0) then
            if (is_steep(laws(i), one)) found = [found, one]
          end if
        end block
      end associate
    end do
  end subroutine find_steep

  !> True if the argument is a rate, and the force opposes it with the exponent, the same on both
  !! sides: one side of the law then gives its force on the other side too.
  logical function is_steep(law, steep)
    type(law_term), intent(in) :: law
    type(steep_law), intent(in) :: steep
    real(wp) :: at(5, size(law%arguments, 1)), f(5), rises(2)
    integer :: k

    is_steep = .false.
    if (.not. any(abs(law%rates(steep%argument, :)) > 0.0_wp)) return
    do k = 1, size(at, 2)
      at(:, k) = 0.1_wp + 0.2_wp*k
    end do
    at(:, steep%argument) = [-near, -nearer, 0.0_wp, nearer, near]
    call law%program%evaluate(at, f)
    if (any(abs(f) >= wall)) return
    if (.not. all(f(2:) > f(:4))) return
    rises = [(f(1) - f(3))/(f(2) - f(3)), (f(5) - f(3))/(f(4) - f(3))]
    is_steep = all(abs(rises/(near/nearer)**steep%exponent - 1.0_wp) <= alike) &
               .and. abs(f(1) + f(5) - 2.0_wp*f(3)) <= odd*(f(5) - f(1)) &
               .and. abs(f(2) + f(4) - 2.0_wp*f(3)) <= odd*(f(4) - f(2))
  end function is_steep

  !> True for a single argument with factors.
  pure logical function is_multiple(signal)
    type(law_program), intent(in) :: signal
    integer :: i
    is_multiple = count(signal%code == put_argument) == 1
    do i = 1, size(signal%code)
      if (all(signal%code(i) /= [put_argument, put_number, multiply, divide])) is_multiple = .false.
    end do
  end function is_multiple

  !> Replace the first sum v + r*d of two arguments that a law reads by an argument of its own.
  pure subroutine join_arguments(law)
    type(law_term), intent(inout) :: law
    integer, parameter :: sum_of_two(5) = [put_argument, put_argument, put_number, multiply, add]
    real(wp) :: of_sum(3)
    integer :: i, n

    n = size(law%arguments, 1) + 1
    i = 0
    do
      i = i + 1
      if (i + 4 > size(law%program%code)) exit
      if (any(law%program%code(i:i + 4) /= sum_of_two)) cycle
      if (size(law%arguments, 1) < n) then
        of_sum = law%program%number(i:i + 2)
        law%arguments = with_sum(law%arguments, of_sum)
        law%rates = with_sum(law%rates, of_sum)
        law%program%n_arguments = n
      end if
      if (any(abs(law%program%number(i:i + 2) - of_sum) > 0.0_wp)) cycle
      law%program%code = [law%program%code(:i), law%program%code(i + 5:)]
      law%program%number = [law%program%number(:i - 1), real(n, wp), law%program%number(i + 5:)]
    end do
  end subroutine join_arguments

  !> The rows and the sum of two of them: their indices, and the factor of the second.
  pure function with_sum(rows, of_sum) result(more)
    real(wp), intent(in) :: rows(:, :), of_sum(3)
    real(wp) :: more(size(rows, 1) + 1, size(rows, 2))
    more(:size(rows, 1), :) = rows
    more(size(more, 1), :) = rows(nint(of_sum(1)), :) + of_sum(3)*rows(nint(of_sum(2)), :)
  end function with_sum

  !> v of w.
  pure elemental real(wp) function rate_of_root(root, exponent) result(rate)
    real(wp), intent(in) :: root, exponent
    rate = sign(abs(root)**(1.0_wp/exponent), root)
  end function rate_of_root

  !> w of v.
  pure elemental real(wp) function root_of_rate(rate, exponent) result(root)
    real(wp), intent(in) :: rate, exponent
    root = sign(abs(rate)**exponent, rate)
  end function root_of_rate

  !> The force of a law and its derivative by w, with the rate of w in place of its argument.
  subroutine steep_force(law, steep, arguments, root, force, slope)
    type(law_term), intent(in) :: law
    type(steep_law), intent(in) :: steep
    !> Shape (n, n_arguments); w, shape (n).
    real(wp), intent(in) :: arguments(:, :), root(:)
    real(wp), intent(out) :: force(:), slope(:)
    real(wp), dimension(size(arguments, 1), size(arguments, 2)) :: at, slopes
    real(wp) :: still(size(root)), part(size(root))

    associate (k => steep%argument, a => steep%exponent)
      at = arguments
      at(:, k) = rate_of_root(root, a)
      part = 1.0_wp
      where (abs(at(:, k)) < least)
        part = abs(root)/least**a
        at(:, k) = sign(least, root)
      end where
      call law%program%differentiate(at, force, slopes)
      slope = slopes(:, k)*abs(at(:, k))**(1.0_wp - a)/a
      if (all(part >= 1.0_wp)) return
      at(:, k) = 0.0_wp
      call law%program%evaluate(at, still)
      where (part < 1.0_wp) force = still + part*(force - still)
    end associate
  end subroutine steep_force

end module viscovib_steep_laws
