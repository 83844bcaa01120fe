!> How fast force laws alone let a system move: of a contact the rate of its stiffness.
module viscovib_law_rates
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: wall
  use viscovib_law_term, only: law_term
  use viscovib_moving_element, only: fastest_settling, moving_element
  implicit none
  private

  public :: part_by_laws

  !> Angles by which the fastest motion turns on a part at most, a quarter turn, and how much less
  !! at least where steps are short; the shortest part, of a step.
  real(wp), parameter :: most = 1.57_wp, least = most/32.0_wp, shortest = 1.0_wp/4096.0_wp

contains

  !> The longest part of a step by the rates that laws have on it, so that the motion turns on it as
  !! little as that of the linear rest does in a step. `thin`: how many times as short the steps
  !! are as the longest of the runs that are compared; parts are as much shorter.
  pure real(wp) function part_by_laws(laws, inverse, rate, h, thin, q, v, elements) &
    result(longest)
    type(law_term), intent(in) :: laws(:)
    !> M^(-1); the rate of the linear rest, the step; states, shape (n, n_dof).
    real(wp), intent(in) :: inverse(:, :), rate, h, thin, q(:, :), v(:, :)
    !> Their states settle, at rates that add to those of forces.
    type(moving_element), intent(in) :: elements(:)
    real(wp) :: angle, fastest
    angle = thin*max(least, min(most, rate*h/thin))
    fastest = fastest_of_laws(laws, inverse, q, v) + fastest_settling(elements, q, v)
    longest = max(angle/max(fastest, tiny(1.0_wp)), shortest*h)
  end function part_by_laws

  !> An upper bound of the rates, at any of some states, of laws with the slopes f_q and f_v that
  !! they have there: the root of the sum of |M^(-1) w f_q|, and the sum of |M^(-1) w f_v|.
  pure real(wp) function fastest_of_laws(laws, inverse, q, v) result(fastest)
    type(law_term), intent(in) :: laws(:)
    !> M^(-1); states, shape (n, n_dof).
    real(wp), intent(in) :: inverse(:, :), q(:, :), v(:, :)
    real(wp) :: square(size(q, 1)), rate(size(q, 1)), value(size(q, 1)), weight
    integer :: i, k

    square = 0.0_wp
    rate = 0.0_wp
    do i = 1, size(laws)
      associate (law => laws(i))
        block
          real(wp) :: slopes(size(q, 1), size(law%arguments, 1))
          weight = sum(abs(matmul(inverse(:, law%equations), law%weights)))
          call law%program%differentiate(matmul(q, transpose(law%arguments)) &
                                         + matmul(v, transpose(law%rates)), value, slopes)
          slopes = min(abs(slopes), sqrt(wall))
          do k = 1, size(slopes, 2)
            square = square + weight*sum(abs(law%arguments(k, :)))*slopes(:, k)
            rate = rate + weight*sum(abs(law%rates(k, :)))*slopes(:, k)
          end do
        end block
      end associate
    end do
    fastest = maxval(sqrt(square) + rate)
  end function fastest_of_laws

end module viscovib_law_rates
